"""The same as `clutter-env layout_pictures`."""

from clutter_env.cli.data.layout_pictures import main

if __name__ == "__main__":
    main()
