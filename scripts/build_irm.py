"""The same as `clutter-env map`."""

from clutter_env.cli.map import main

if __name__ == "__main__":
    main()
