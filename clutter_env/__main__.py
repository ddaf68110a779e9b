"""`python -m clutter_env COMMAND ...` is `clutter-env COMMAND ...`."""

from clutter_env.cli.main import main

if __name__ == "__main__":
    main()
