"""Plan, draw, save, load and execute in a scene of your own, with your own strategy and task planner."""

import mujoco

from assets import FETCH
from planners import AStar, Planner, Scene, Solution, Strategy, execute

BOXES = {"tea": (0.95, -0.06), "rice": (0.95, 0.06), "salt": (1.05, 0.1), "flour": (1.05, -0.1), "sugar": (1.15, 0)}
BODY = '<body name="{}" pos="{} {} 0.82"><freejoint/><geom type="box" size="0.025 0.025 0.08" mass="0.2"/></body>'
KITCHEN = f"""<mujoco><include file="{FETCH.mjcf_path}"/>
  <option timestep="0.002" integrator="implicitfast" cone="elliptic" impratio="10"/>
  <default><geom contype="1" conaffinity="3" friction="1 0.02 0.0005"/></default>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1"/>
    <geom name="table" type="box" size="0.35 0.5 0.37" pos="1.2 0 0.37"/>
    <geom name="pillar" type="cylinder" size="0.04 0.4" pos="1.1 0.35 1.14"/>
    <body name="can" pos="1.05 0 0.8"><freejoint/><geom type="cylinder" size="0.03 0.06" mass="0.2"/></body>
    {"".join(BODY.format(name, *place) for name, place in BOXES.items())}
  </worldbody></mujoco>"""


class LoggingPlanner:
    def plan(self, problem, time_limit):
        print(found := AStar().plan(problem, time_limit))
        return found


model = mujoco.MjModel.from_xml_string(KITCHEN)
data = mujoco.MjData(model)
data.qpos[[model.joint(name).qposadr[0] for name in FETCH.drive_joints[3:]]] = FETCH.home
mujoco.mj_forward(model, data)
scene = Scene.from_mujoco(model, data, FETCH, movable=["can", *BOXES], support="table")
strategy = Strategy("nearest", grasps="greedy", region="ngr1", locations="priority")
solution = Planner(FETCH, grasps="side", engine=LoggingPlanner()).solve(scene, "can", strategy)
print(solution.summary())
solution.save("plan.npz")
solution.plot().figure.savefig("plan.png")
print(execute(Solution.load("plan.npz"), model, data))
