"""The names of the package, from the modules that define them. `planners` loads them on first use."""

from irm.gjk import CYLINDER as CYLINDER
from planners.cause import Cause as Cause
from planners.checking import check as check
from planners.clearing.goal_bound import LowerBound as LowerBound
from planners.clearing.lower_bound import ClearanceFloor as ClearanceFloor
from planners.collision.scene_arrays import (
    GeometryError as GeometryError,
    RobotArrays as RobotArrays,
    robot_arrays as robot_arrays,
)
from planners.collision.world import CollisionWorld as CollisionWorld, validate as validate
from planners.contact import (
    Contact as Contact,
    StepLabel as StepLabel,
    contact_of as contact_of,
    contacts as contacts,
    label_of as label_of,
)
from planners.expert.config import (
    ExpertConfig as ExpertConfig,
    ExpertError as ExpertError,
    MonitorConfig as MonitorConfig,
)
from planners.expert.controller import ControlledWorld as ControlledWorld, Controller as Controller
from planners.expert.execute import ExecutionResult as ExecutionResult, execute as execute, follow as follow
from planners.expert.executor import Command as Command, Executor as Executor
from planners.expert.expert import TampExpert as TampExpert
from planners.expert.interfaces import ControlledEnv as ControlledEnv, controlled_env as controlled_env
from planners.expert.monitor import Sensor as Sensor, held_object as held_object
from planners.expert.report import EpisodeReport as EpisodeReport
from planners.following import FollowingPlanner as FollowingPlanner
from planners.goals import Goal as Goal
from planners.grasping.arm_configurations import (
    ConfigurationGrid as ConfigurationGrid,
    GripperPoses as GripperPoses,
    scan_configurations as scan_configurations,
)
from planners.grasping.base_placement import map_parameters as map_parameters
from planners.grasping.candidates import gripper_poses as gripper_poses
from planners.grasping.families import (
    SIDE as SIDE,
    TOP as TOP,
    AntipodalFamily as AntipodalFamily,
    GraspFamily as GraspFamily,
    find_grasp_set as find_grasp_set,
)
from planners.grasping.grasp_poses import (
    generate_grasps as generate_grasps,
    gripper_clearances as gripper_clearances,
    gripper_opening as gripper_opening,
)
from planners.grasping.side_grasps import SideGripper as SideGripper, reachable_side_grasps as reachable_side_grasps
from planners.motion.arm import tcp_pose as tcp_pose
from planners.motion.path import NoPath as NoPath
from planners.motion.trajectory import CONTROL_STEP as CONTROL_STEP
from planners.placing.locations import rotated as rotated, stand_at as stand_at
from planners.planner import (
    Planner as Planner,
    clearance_floor as clearance_floor,
    lower_bound as lower_bound,
    solve as solve,
    warmup as warmup,
)
from planners.problem import Problem as Problem
from planners.regions import GoalError as GoalError, Region as Region
from planners.scene import (
    Body as Body,
    HeldObject as HeldObject,
    RobotState as RobotState,
    Scene as Scene,
    SceneError as SceneError,
    Solid as Solid,
)
from planners.scene.bodies import release_pitch as release_pitch
from planners.scene.cover import BACK as BACK, drive_out as drive_out, heading as heading, is_covered as is_covered
from planners.scene.findings import Finding as Finding, Reason as Reason, SceneReport as SceneReport
from planners.scene.insert import insert_robot as insert_robot
from planners.scene.prepare import Change as Change, Prepared as Prepared, prepare as prepare
from planners.scene.robot_names import robot_prefix as robot_prefix
from planners.scene.settle import Settled as Settled, settle as settle
from planners.scene.solid import StaticObstacle as StaticObstacle
from planners.search.expert import SearchExpert as SearchExpert
from planners.search.report import SearchReport as SearchReport, SearchStep as SearchStep
from planners.skills import (
    DIRECTIONS as DIRECTIONS,
    Skill as Skill,
    SkillFailure as SkillFailure,
    SkillPlanner as SkillPlanner,
)
from planners.standing import standing_place as standing_place
from planners.strategies import STRATEGIES as STRATEGIES, Strategy as Strategy, find_strategy as find_strategy
from planners.symbolic.astar import AStar as AStar
from planners.symbolic.problem import (
    GroundAction as GroundAction,
    NoPlan as NoPlan,
    SymbolicState as SymbolicState,
    TaskPlan as TaskPlan,
    TaskPlanner as TaskPlanner,
    TaskProblem as TaskProblem,
    format_plan as format_plan,
)
from planners.symbolic.transitions import applicable_actions as applicable_actions, apply_action as apply_action
from planners.tamp.joint_trajectory import JointTrajectory as JointTrajectory
from planners.tamp.plan_file import PlanFileError as PlanFileError
from planners.tamp.solution import BoundAction as BoundAction, Infeasible as Infeasible, Solution as Solution
from planners.workspace import ArmsError as ArmsError, Workspace as Workspace
