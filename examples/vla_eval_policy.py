"""A learned policy of this package, played by vla-eval on a suite: it sees where everything stands.

    venv-vla/bin/python examples/vla_eval_policy.py

See docs/guides/vla_eval.md.
"""

from __future__ import annotations

import vla_eval

from clutter_env.policies.vla_eval_server import PackagePolicy

SUITE = "side-15-v3"
BENCHMARK = {
    "benchmark": "clutter_env.bridges.for_vla_eval:SuiteBenchmark",
    "episodes_per_task": 3,
    "params": {"suite": SUITE, "exact": True},
}

if __name__ == "__main__":
    config = {"benchmarks": [BENCHMARK], "output_dir": "outputs/vla"}
    (found,) = vla_eval.evaluate(PackagePolicy("keyframes", SUITE), config)
    print(f"mean success: {found['mean_success']}")
