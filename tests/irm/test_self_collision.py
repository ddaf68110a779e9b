"""Self-collision of an arm read from an MJCF file."""

import numpy as np

from irm.verification import SelfCollision
from tests.irm.arms import arm_chain, arm_model


def test_a_folded_arm_touches_itself_and_a_stretched_one_does_not():
    model, chain = arm_model("pr2_arm"), arm_chain("pr2_arm")
    is_free = SelfCollision(model, chain)
    stretched = np.array([0.2, -0.5, 0.0, 0.0, -0.3, 0.0, -0.1, 0.0])
    folded = np.array([0.2, 0.7, 0.9, 0.0, -2.3, 0.0, -2.0, 0.0])
    assert is_free(np.zeros(3), stretched)
    assert not is_free(np.zeros(3), folded)
    assert is_free(np.array([5.0, 1.0, 2.0]), stretched)
