"""The report of an episode."""

from __future__ import annotations

from dataclasses import dataclass, replace

__all__ = ["EpisodeReport"]


@dataclass(frozen=True)
class EpisodeReport:
    """How an episode went.

    Attributes:
        planned: the last solve found a plan.
        executed: the last plan was executed to its end.
        scored: the target is held up.
        clean: it is, and no object has fallen or been disturbed since the environment's reset, as the environment's
            info counts them; None if the environment has no such counts.
        failure: the reason for failure, "" for success.
        clearances: objects put aside in the simulation, in order.
        duplicated: those put aside more than once.
        replans: number of plans after the first one.
        floor: minimum number of objects that any plan must clear; None if it was not computed or not proved.
        planning_s: [s] CPU time spent on planning.
        sim_s: [s] simulated time since reset.
        contacts: grasps and releases in the plans of the episode, all together.
        not_straight: those of them for which the base does not face the gripper with the gripper's yaw; of a canonical
            planner, those where it had to fall back.
        deviations: the deviations that stopped plans, as text, such as "object_03: toppled".
    """

    planned: bool = False
    executed: bool = False
    scored: bool = False
    clean: bool | None = None
    failure: str = ""
    clearances: tuple[str, ...] = ()
    duplicated: tuple[str, ...] = ()
    replans: int = 0
    floor: int | None = None
    planning_s: float = 0.0
    sim_s: float = 0.0
    contacts: int = 0
    not_straight: int = 0
    deviations: tuple[str, ...] = ()

    @property
    def result(self) -> str:
        """What came of the episode: "success", why not, or what was wrong with it."""
        if not self.scored:
            return self.failure or "the target was not held up"
        return "success" if self.clean is not False else "an object has fallen or been disturbed"

    def rows(self) -> dict[str, str]:
        """The results in words, by name."""
        flags = (self.planned, self.executed, self.scored)
        return {
            "planned, executed, scored": ", ".join("yes" if done else "no" for done in flags),
            "objects cleared": f"{len(self.clearances)} ({', '.join(self.clearances) or 'none'})",
            "cleared twice or more": str(len(self.duplicated)),
            "minimum number of clearances": "not proved" if self.floor is None else str(self.floor),
            "replans after deviations": f"{self.replans} ({'; '.join(self.deviations)})" if self.replans else "0",
            "planning": f"{self.planning_s:.2f} s of CPU time",
            "simulated time": f"{self.sim_s:.1f} s",
        }

    def with_clearances(self, names: list[str]) -> EpisodeReport:
        """The report after more clearances."""
        clearances = (*self.clearances, *names)
        duplicated = tuple(sorted({name for name in clearances if clearances.count(name) > 1}))
        return replace(self, clearances=clearances, duplicated=duplicated)

    def with_contacts(self, are_straight: list[bool]) -> EpisodeReport:
        """The report after one more plan, whose contacts are straight or not."""
        return replace(
            self,
            contacts=self.contacts + len(are_straight),
            not_straight=self.not_straight + are_straight.count(False),
        )
