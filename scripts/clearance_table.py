"""The same as `clutter-env table`."""

from clutter_env.cli.table import main

if __name__ == "__main__":
    main()
