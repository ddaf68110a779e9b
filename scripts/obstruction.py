"""Run `clutter_env.cli.data.obstruction`."""

from clutter_env.cli.data.obstruction import main

if __name__ == "__main__":
    main()
