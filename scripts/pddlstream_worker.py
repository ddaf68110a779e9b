"""One run of PDDLStream's own example `packed`, in a Python that has it; called by `scripts/compare_pddlstream.py`.

    python pddlstream_worker.py FOLDER BLOCKS SEED SECONDS

FOLDER is a checkout of caelan/pddlstream. Its code is run as it is. Put back are only names that Python 3.10 and NumPy
1.24 have dropped; the seeds of its random numbers, which it draws anew each time, are set. The last line printed is
JSON: the blocks' poses and what was found.
"""

import collections
import collections.abc
import fractions
import json
import math
import os
import random
import sys
import time
from typing import Any

import numpy as np


def main(folder: str, blocks: int, seed: int, seconds: int) -> None:
    """Run the example, and print what was found."""
    for name in collections.abc.__all__:
        setattr(collections, name, getattr(collections.abc, name))
    for name, kind in (("float", float), ("int", int), ("bool", bool)):
        if name not in np.__dict__:
            setattr(np, name, kind)
    vars(fractions)["gcd"] = math.gcd
    os.chdir(folder)
    sys.path.insert(0, ".")
    from examples.pybullet.tamp import problems, run  # theirs; not installed
    from examples.pybullet.utils.pybullet_tools.utils import get_pose  # theirs; not installed

    found: dict[str, Any] = {}

    def packed(**kwargs: Any) -> Any:
        """Their problem; its blocks' poses are noted."""
        problem = problems.packed(**kwargs)
        found["blocks"] = [[*map(float, get_pose(one)[0]), *map(float, get_pose(one)[1])] for one in problem.movable]
        return problem

    def solve(*args: Any, **kwargs: Any) -> Any:
        """Their planner; its answer and CPU time, with that of the task planner that it calls, are noted."""
        before, started, called = time.process_time(), time.perf_counter(), sum(os.times()[2:4])
        solution = their_solve(*args, **kwargs)
        plan = solution[0]
        found.update(
            cpu_s=time.process_time() - before + sum(os.times()[2:4]) - called,
            wall_s=time.perf_counter() - started,
            solved=plan is not None,
            picks=sum(getattr(action, "name", action[0]) == "pick" for action in plan or ()),
        )
        return solution

    their_solve, run.solve, run.PROBLEMS = run.solve, solve, [packed]
    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002  theirs are the global ones
    sys.argv = ["run", "-problem", "packed", "-n", str(blocks), "-t", str(seconds)]
    run.main()
    print(json.dumps(found))


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:5]))
