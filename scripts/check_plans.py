"""Run `clutter_env.cli.check_plans`."""

from clutter_env.cli.check_plans import main

if __name__ == "__main__":
    main()
