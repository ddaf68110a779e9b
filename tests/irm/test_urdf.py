"""Arms read from URDF files."""

import numpy as np
import pytest

from irm import ArmChain, forward
from irm.errors import ChainError

AXES = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0")
MESH = '<visual><geometry><mesh filename="package://nowhere/x.stl"/></geometry></visual>'
JOINT = """<joint name="j{k}" type="revolute"><parent link="l{k}"/><child link="l{n}"/><origin xyz="0 0 0.2"/>
  <axis xyz="{axis}"/><limit lower="-2" upper="2" effort="1" velocity="1"/></joint>"""


def urdf():
    links = "".join(f'<link name="l{k}">{MESH}</link>' for k in range(7))
    joints = "".join(JOINT.format(k=k, n=k + 1, axis=axis) for k, axis in enumerate(AXES))
    fixed = '<parent link="l6"/><child link="tip"/><origin xyz="0 0 0.1"/>'
    tip = f'<link name="tip"/><joint name="t" type="fixed">{fixed}</joint>'
    return f'<robot name="six">{links}{tip}{joints}</robot>'


def test_a_chain_is_that_of_its_file_and_meshes_may_be_missing(tmp_path):
    file = tmp_path / "six.urdf"
    file.write_text(urdf())
    chain = ArmChain.from_urdf(file, base="l0", tip="tip", approach="z")
    assert (chain.size, chain.joints[1:]) == (7, tuple(f"j{k}" for k in range(6)))
    np.testing.assert_allclose(forward(chain, np.zeros(7))[:3, 3], (0.0, 0.0, 1.3), atol=1e-12)
    np.testing.assert_allclose(forward(chain, np.zeros(7))[:3, 0], (0.0, 0.0, 1.0), atol=1e-12)


def test_what_is_no_urdf_file_is_refused(tmp_path):
    file = tmp_path / "none.urdf"
    file.write_text("<robot")
    with pytest.raises(ChainError, match="URDF"):
        ArmChain.from_urdf(file, "l0", "tip")
