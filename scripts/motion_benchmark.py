"""The same as `clutter-env motion_benchmark`."""

from clutter_env.cli.checks.motion_benchmark import main

if __name__ == "__main__":
    main()
