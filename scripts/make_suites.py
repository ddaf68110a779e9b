"""Run `clutter_env.cli.data.make_suites`."""

from clutter_env.cli.data.make_suites import main

if __name__ == "__main__":
    main()
