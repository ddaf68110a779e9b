"""The same as `clutter-env soak`."""

from clutter_env.cli.checks.soak import main

if __name__ == "__main__":
    main()
