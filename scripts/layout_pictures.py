"""The same as `clutter-env layout_pictures`."""

from clutter_env.cli.layout_pictures import main

if __name__ == "__main__":
    main()
