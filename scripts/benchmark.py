"""The same as `clutter-env benchmark`."""

from clutter_env.cli.benchmark import main

if __name__ == "__main__":
    main()
