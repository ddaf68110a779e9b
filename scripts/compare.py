"""The same as `clutter-env compare`."""

from clutter_env.cli.compare import main

if __name__ == "__main__":
    main()
