"""The loop of all workers: runs a file, and lets its `Worker` answer calls, one JSON object a line, until they end.

It imports only Python's own modules, since a worker runs in the environment of somebody's package. What that package
prints goes to standard error.
"""

import json
import os
import runpy
import sys
import traceback


def main(file: str) -> None:
    """Answer the calls on standard input."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    worker = runpy.run_path(file)["Worker"]()
    for line in sys.stdin:
        request = json.loads(line)
        try:
            answer = getattr(worker, request.pop("call"))(**request)
        except Exception:
            answer = {"error": traceback.format_exc()}
        print(json.dumps(answer), file=answers, flush=True)


if __name__ == "__main__":
    main(sys.argv[1])
