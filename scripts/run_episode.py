"""The same as `clutter-env episode`."""

from clutter_env.cli.episode import main

if __name__ == "__main__":
    main()
