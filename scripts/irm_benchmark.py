"""The same as `clutter-env map benchmark`."""

from clutter_env.cli.maps.benchmark import main

if __name__ == "__main__":
    main()
