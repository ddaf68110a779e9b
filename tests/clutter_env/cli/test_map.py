"""The command `clutter-env map` and its sub-commands."""

import json
import sys
from dataclasses import fields
from pathlib import Path

import mujoco
import pytest

from assets.robots import FETCH
from clutter_env.cli.main import main
from clutter_env.cli.map import Arguments
from clutter_env.cli.robot import robot_by_name
from irm import MapParameters, compare_with_model
from irm.chain import ArmChain
from irm.errors import ChainError
from irm.reachability_map import ReachabilityMap

PANDA = Path(__file__).resolve().parents[2] / "data" / "arms" / "panda.xml"
NO_ROBOTS = {
    "nonesuch": "fetch",
    "no.such.module:ROBOT": "there is no robot 'no.such.module:ROBOT'",
    "assets.robots:NO_ROBOT": "there is no robot 'assets.robots:NO_ROBOT'",
    "assets.robots:RobotSpec": "not a RobotSpec",
}
COARSE = ["--voxel", "0.25", "--orientations", "6"]


def test_a_map_is_built_saved_and_reported(tmp_path, capsys):
    file, report = tmp_path / "map.npz", tmp_path / "report.json"
    main(["map", *COARSE, "--out", str(file), "--json", str(report)])
    rm = ReachabilityMap.load(file, FETCH)
    assert json.loads(report.read_text())["poses"] == len(rm)
    assert f"poses: {len(rm)}" in capsys.readouterr().out


def test_any_arm_of_an_mjcf_file_in_one_command(tmp_path, capsys):
    file = tmp_path / "panda.npz"
    names = ["--base", "base", "--tip", "tcp", "--approach", "z"]
    main(["map", str(PANDA), *names, *COARSE, "--samples", "20000", "--out", str(file)])
    rm = ReachabilityMap.load(file, ArmChain.from_mjcf(PANDA, "base", "tcp", "z"))
    assert f"poses: {len(rm)}" in capsys.readouterr().out
    assert file.with_suffix(".png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        *((["--robot", name], message) for name, message in NO_ROBOTS.items()),
        ([str(PANDA)], "needs --base"),
        (
            [str(PANDA), "--base", "bse", "--tip", "tcp"],
            "no body 'bse'; did you mean 'base'\\? there are 'world', 'base'",
        ),
        (["none.xml", "--base", "base", "--tip", "tcp"], "none.xml cannot be read"),
    ],
)
def test_an_arm_that_does_not_exist_is_a_clear_message(words, message):
    with pytest.raises(SystemExit, match=message):
        main(["map", *words])


def test_a_chain_of_an_mjcf_file_is_compared_with_it():
    model, chain = mujoco.MjModel.from_xml_path(str(PANDA)), ArmChain.from_mjcf(PANDA, "base", "tcp", "z")
    with pytest.raises(ChainError, match="does not agree"):
        compare_with_model(chain, model, "base", "tcp", "x")


def test_the_options_have_the_defaults_of_maps():
    """The command repeats them, since maps take long to import."""
    options = {entry.name: entry.default for entry in fields(Arguments)}
    parameters = {entry.name: entry.default for entry in fields(MapParameters)}
    assert {name: options[name] for name in parameters if name in options} == {
        name: value for name, value in parameters.items() if name in options
    }


def test_a_robot_of_a_module_in_the_current_directory_is_found(tmp_path, monkeypatch):
    """A console script does not look there by itself."""
    (tmp_path / "own_robots.py").write_text("from assets import FETCH as MINE\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.path", list(sys.path))
    assert robot_by_name("own_robots:MINE") is FETCH
