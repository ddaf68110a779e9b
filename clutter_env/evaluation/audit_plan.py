"""Size of an audit."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class AuditPlan:
    """Settings of an audit."""

    expert: str = "lookahead-all"
    """The policy that demonstrates, and with whose success the others are compared."""
    scenes: int = 100
    """Number of scenes, the first ones of the test split."""
    expert_scenes: int | None = None
    """Of those, the number that the expert plays too, all if not given. With 0 its score is that of its demonstrations,
    which saves time."""
    demonstrations: int = 100
    """Number of scenes of the validation split on which the expert demonstrates."""
    network: bool = False
    """Also train and play networks of 0.1 million parameters, which needs PyTorch."""
    suites: int = 0
    """Number of other suites that are drawn by the same rules."""
    spread_policy: str = ""
    """The policy that plays those. The expert if not given."""
    workers: int = 2
    """Number of processes of the expert. The other policies play in one."""
