"""Data files of the package."""

from pathlib import Path

_ROOT = Path(__file__).resolve().parent


def folder(name: str) -> Path:
    """Path of a folder of `assets/`."""
    return _ROOT / name


def names(kind: str) -> tuple[str, ...]:
    """Names, without their ending, of the JSON files in the folder `kind` of `assets/`, in alphabetical order."""
    return tuple(sorted(file.stem for file in folder(kind).glob("*.json")))


def path(relative: str) -> Path:
    """Path of a data file shipped with the package.

    Args:
        relative: path below `assets/`, for example `"mjcf/fetch.xml"`, or an absolute path.

    Raises:
        FileNotFoundError: no such file. The message lists the files that exist.
    """
    file = _ROOT / relative
    if not file.is_file():
        suffixes = {".xml", ".pddl", ".json", ".npz"}
        known = sorted(str(f.relative_to(_ROOT)) for f in _ROOT.rglob("*") if f.suffix in suffixes)
        raise FileNotFoundError(f"no asset {relative!r}; known assets: {', '.join(known)}")
    return file
