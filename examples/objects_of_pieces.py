"""Grasp and lift objects of several convex pieces, each from among cylinders on a table, in MuJoCo with Fetch.

    python objects_of_pieces.py --scenes 20 --objects mug bowl

The kettle's mesh is that of the package gymnasium-robotics (`pip install 'clutter-env[visuals]'`).
"""

import argparse
import importlib.util
import itertools
from collections import namedtuple
from pathlib import Path

import mujoco
import numpy as np

from assets import FETCH
from planners import Scene, Solution, execute, prepare, solve

TABLE = np.array((1.1, 0.0, 0.74))
SPEC = importlib.util.find_spec("gymnasium_robotics")
KETTLE = Path(SPEC.origin).parent / "envs/assets/kitchen_franka/kitchen_assets/meshes/kettle.stl" if SPEC else None


def wall(name, low, high, thickness, count=14):
    """A ring of `count` hulls between two circles (radius, height): meshes, and the geoms that show them."""
    meshes, geoms = "", ""
    for k in range(count):
        points = [
            (r * np.cos(a), r * np.sin(a), z)
            for radius, z in (low, high)
            for r in (radius, radius - thickness)
            for a in np.array((k, k + 1)) * 2 * np.pi / count
        ]
        vertices = " ".join(f"{value:.5f}" for value in np.ravel(points))
        meshes += f'<mesh name="{name}_{k}" vertex="{vertices}"/>'
        geoms += f'<geom type="mesh" mesh="{name}_{k}" mass="0.006"/>'
    return meshes, geoms


def geom(kind, size, pos=(0, 0, 0), mass=0.05, **more):
    """One geom as MJCF."""
    numbers = {"size": size, "pos": pos, **more}
    texts = " ".join(f'{key}="{" ".join(map(str, np.ravel(value)))}"' for key, value in numbers.items())
    return f'<geom type="{kind}" {texts} mass="{mass}"/>'


def objects():
    """Meshes and geoms of each object; the origin is on its bottom."""
    mug, pan = wall("mug", (0.038, 0.004), (0.040, 0.095), 0.004), wall("pan", (0.075, 0.004), (0.085, 0.045), 0.005)
    profile = ((0.035, 0.004), (0.062, 0.022), (0.073, 0.045), (0.075, 0.065))
    rings = [wall(f"bowl_{k}", low, high, 0.005, 12) for k, (low, high) in enumerate(itertools.pairwise(profile))]
    bowl = ["".join(texts) for texts in zip(*rings, strict=True)]
    handle = geom("capsule", (0.005,), fromto=(0.038, 0, 0.03, 0.07, 0, 0.03))
    handle += geom("capsule", (0.005,), fromto=(0.038, 0, 0.08, 0.07, 0, 0.08))
    handle += geom("capsule", (0.005,), fromto=(0.07, 0, 0.03, 0.07, 0, 0.08))
    shoulder = " ".join(
        f"{r * np.cos(a):.5f} {r * np.sin(a):.5f} {z}"
        for r, z in ((0.035, 0.13), (0.014, 0.17))
        for a in np.arange(16) * np.pi / 8
    )
    found = {
        "mug": (mug[0], mug[1] + geom("cylinder", (0.038, 0.004), (0, 0, 0.004)) + handle),
        "bowl": (bowl[0], bowl[1] + geom("cylinder", (0.035, 0.004), (0, 0, 0.004), 0.1)),
        "bottle": (
            f'<mesh name="shoulder" vertex="{shoulder}"/>',
            geom("cylinder", (0.035, 0.065), (0, 0, 0.065), 0.3)
            + '<geom type="mesh" mesh="shoulder" mass="0.05"/>'
            + geom("cylinder", (0.014, 0.025), (0, 0, 0.195), 0.02),
        ),
        "pan": (
            pan[0],
            pan[1]
            + geom("cylinder", (0.075, 0.004), (0, 0, 0.004), 0.3)
            + geom("capsule", (0.01,), mass=0.08, fromto=(0.085, 0, 0.038, 0.22, 0, 0.05)),
        ),
        "box": (
            "",
            geom("box", (0.06, 0.045, 0.03), (0, 0, 0.03), 0.2)
            + geom("cylinder", (0.006, 0.008), (0, 0, 0.068), 0.01)
            + geom("sphere", (0.014,), (0, 0, 0.086), 0.02),
        ),
    }
    if KETTLE is not None:
        grip = [geom("capsule", (0.007,), fromto=(x, 0, 0.06, x, 0, 0.15)) for x in (-0.06, 0.06)]
        grip.append(geom("capsule", (0.007,), fromto=(-0.06, 0, 0.15, 0.06, 0, 0.15)))
        mesh = f'<mesh name="kettle" file="{KETTLE}" scale="0.6 0.6 0.6" maxhullvert="64"/>'
        found["kettle"] = (mesh, '<geom type="mesh" mesh="kettle" mass="0.4"/>' + "".join(grip))
    return found


def make(name, seed, cylinders=6):
    """A model, its data, and the names of its movable bodies: the object somewhere on the table, cylinders around."""
    rng, (meshes, geoms) = np.random.default_rng(seed), objects()[name]
    reach = {"mug": 0.08, "bowl": 0.08, "bottle": 0.04, "pan": 0.23, "box": 0.08, "kettle": 0.12}[name]
    at, yaw = TABLE[:2] + rng.uniform((-0.12, -0.2), (0.08, 0.2)), rng.uniform(-np.pi, np.pi)
    places, bodies = [(*at, reach)], []
    while len(bodies) < cylinders:
        radius, half = rng.uniform(0.02, 0.03), rng.uniform(0.05, 0.09)
        x, y = TABLE[:2] + rng.uniform((-0.25, -0.4), (0.25, 0.4))
        if all(np.hypot(x - a, y - b) > radius + r + 0.03 for a, b, r in places):
            places.append((x, y, radius))
            cylinder = geom("cylinder", (radius, half), mass=0.2)
            bodies.append(
                f'<body name="can_{len(bodies)}" pos="{x} {y} {TABLE[2] + half}"><freejoint/>{cylinder}</body>'
            )
    model = mujoco.MjModel.from_xml_string(f"""<mujoco><include file="{FETCH.mjcf_path}"/>
      <option timestep="0.002" integrator="implicitfast" cone="elliptic" impratio="10"/>
      <default><geom contype="1" conaffinity="3" friction="1 0.02 0.0005"/></default>
      <asset>{meshes}</asset>
      <worldbody>
        <light pos="0 0 3"/>
        <geom name="floor" type="plane" size="0 0 1" rgba=".8 .8 .8 1"/>
        <geom name="table" type="box" size=".35 .5 .37" pos="{TABLE[0]} 0 {TABLE[2] - 0.37}" rgba=".8 .7 .5 1"/>
        <body name="{name}" pos="{at[0]} {at[1]} {TABLE[2]}" quat="{np.cos(yaw / 2)} 0 0 {np.sin(yaw / 2)}">
          <freejoint/>{geoms}</body>
        {"".join(bodies)}
      </worldbody></mujoco>""")
    model = prepare(model, FETCH).model
    data = mujoco.MjData(model)
    data.qpos[[model.joint(joint).qposadr[0] for joint in FETCH.drive_joints[3:]]] = FETCH.home
    data.ctrl[[model.actuator(joint).id for joint in FETCH.drive_joints[3:]]] = FETCH.home
    mujoco.mj_forward(model, data)
    return model, data, [name, *(f"can_{k}" for k in range(cylinders))]


Outcome = namedtuple("Outcome", "planned lifted clean detail")


def lift(name, seed):
    """Plan and execute; lifted is what ends 10 cm higher, clean if nothing else was moved and nothing slipped."""
    model, data, movable = make(name, seed)
    scene = Scene.from_mujoco(model, data, FETCH, movable=movable, support="table")
    found = solve(scene, name, rng=np.random.default_rng(0))
    if not isinstance(found, Solution):
        return Outcome(False, False, False, f"{found.cause}: {found.detail}")
    result = execute(found, model, data)
    end = Scene.from_mujoco(model, data, FETCH, movable=movable, support="table").body(name)
    rise = end.bottom - scene.body(name).bottom
    return Outcome(True, rise > 0.1, result.finished, f"{rise:.2f} m, {result.deviation}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--objects", nargs="+", default=list(objects()))
    parser.add_argument("--scenes", type=int, default=1)
    arguments = parser.parse_args()
    for name in arguments.objects:
        ends = [lift(name, seed) for seed in range(arguments.scenes)]
        planned, lifted, clean = (sum(column) for column in list(zip(*ends, strict=True))[:3])
        print(f"{name}: {planned} planned, {lifted} lifted, {clean} clean, of {len(ends)}", flush=True)
        for seed, end in enumerate(ends):
            if not end.clean:
                print(f"  scene {seed}: {end.detail}")
