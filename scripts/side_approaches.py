"""Run `clutter_env.cli.data.side_approaches`."""

from clutter_env.cli.data.side_approaches import main

if __name__ == "__main__":
    main()
