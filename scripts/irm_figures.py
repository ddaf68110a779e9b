"""The same as `clutter-env map figures`."""

from clutter_env.cli.maps.figures import main

if __name__ == "__main__":
    main()
