"""The same as `clutter-env train`."""

from clutter_env.cli.train import main

if __name__ == "__main__":
    main()
