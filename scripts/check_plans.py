"""Run `clutter_env.cli.checks.check_plans`."""

from clutter_env.cli.checks.check_plans import main

if __name__ == "__main__":
    main()
