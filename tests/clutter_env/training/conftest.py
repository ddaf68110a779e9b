"""Training needs the extra [rl]."""

from importlib.util import find_spec

collect_ignore_glob = [] if find_spec("torch") and find_spec("sb3_contrib") else ["test_*.py"]
