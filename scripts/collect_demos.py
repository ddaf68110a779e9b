"""The same as `clutter-env collect`."""

from clutter_env.cli.collect import main

if __name__ == "__main__":
    main()
