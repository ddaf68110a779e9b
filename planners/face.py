"""The names of the package, from the modules that define them; `planners` itself loads them when one is asked for."""

from irm.gjk import CYLINDER
from planners.cause import Cause
from planners.clearing.goal_bound import LowerBound
from planners.clearing.lower_bound import ClearanceFloor
from planners.collision.scene_arrays import GeometryError, RobotArrays, robot_arrays
from planners.collision.world import CollisionWorld, validate
from planners.contact import Contact, StepLabel, contact_of, contacts, label_of
from planners.context import ArmsError, PlanningContext
from planners.expert.config import ExpertConfig, ExpertError, MonitorConfig
from planners.expert.controller import ControlledWorld, Controller
from planners.expert.execute import ExecutionResult, execute, follow
from planners.expert.executor import Command, Executor
from planners.expert.expert import TampExpert
from planners.expert.interfaces import ControlledEnv, controlled_env
from planners.expert.monitor import Sensor, held_object
from planners.expert.report import EpisodeReport
from planners.goals import Goal, GoalError, Region
from planners.grasping.arm_configurations import (
    ConfigurationGrid,
    GripperPoses,
    scan_configurations,
)
from planners.grasping.base_placement import map_parameters
from planners.grasping.candidates import gripper_poses
from planners.grasping.families import SIDE, TOP, AntipodalFamily, GraspFamily, find_grasp_set
from planners.grasping.grasp_poses import generate_grasps, gripper_clearances, gripper_opening
from planners.grasping.side_grasps import SideGripper, reachable_side_grasps
from planners.motion.arm import tcp_pose
from planners.motion.path import NoPath
from planners.motion.trajectory import CONTROL_STEP
from planners.placing.locations import rotated, stand_at
from planners.planner import Planner, clearance_floor, lower_bound, solve, warmup
from planners.scene import Body, HeldObject, RobotState, Scene, SceneError, Solid
from planners.scene.bodies import release_pitch
from planners.scene.cover import BACK, drive_out, heading, is_covered
from planners.scene.insert import insert_robot
from planners.scene.prepare import Change, Prepared, prepare
from planners.scene.static_obstacle import StaticObstacle
from planners.search.expert import SearchExpert, SearchReport, SearchStep
from planners.skills import DIRECTIONS, Skill, SkillFailure, SkillPlanner, plan_contact
from planners.standing import standing_place
from planners.strategies import STRATEGIES, Strategy, find_strategy
from planners.symbolic.astar import AStar
from planners.symbolic.problem import (
    GroundAction,
    NoPlan,
    SymbolicState,
    TaskPlan,
    TaskPlanner,
    TaskProblem,
    format_plan,
)
from planners.symbolic.transitions import applicable_actions, apply_action
from planners.tamp.joint_trajectory import JointTrajectory
from planners.tamp.motion_layer import MotionLayer
from planners.tamp.plan_file import PlanFileError
from planners.tamp.solution import BoundAction, Infeasible, Solution

__all__ = [
    "BACK",
    "CONTROL_STEP",
    "CYLINDER",
    "DIRECTIONS",
    "SIDE",
    "STRATEGIES",
    "TOP",
    "AStar",
    "AntipodalFamily",
    "ArmsError",
    "Body",
    "BoundAction",
    "Cause",
    "Change",
    "ClearanceFloor",
    "CollisionWorld",
    "Command",
    "ConfigurationGrid",
    "Contact",
    "ControlledEnv",
    "ControlledWorld",
    "Controller",
    "EpisodeReport",
    "ExecutionResult",
    "Executor",
    "ExpertConfig",
    "ExpertError",
    "GeometryError",
    "Goal",
    "GoalError",
    "GraspFamily",
    "GripperPoses",
    "GroundAction",
    "HeldObject",
    "Infeasible",
    "JointTrajectory",
    "LowerBound",
    "MonitorConfig",
    "MotionLayer",
    "NoPath",
    "NoPlan",
    "PlanFileError",
    "Planner",
    "PlanningContext",
    "Prepared",
    "Region",
    "RobotArrays",
    "RobotState",
    "Scene",
    "SceneError",
    "SearchExpert",
    "SearchReport",
    "SearchStep",
    "Sensor",
    "SideGripper",
    "Skill",
    "SkillFailure",
    "SkillPlanner",
    "Solid",
    "Solution",
    "StaticObstacle",
    "StepLabel",
    "Strategy",
    "SymbolicState",
    "TampExpert",
    "TaskPlan",
    "TaskPlanner",
    "TaskProblem",
    "applicable_actions",
    "apply_action",
    "clearance_floor",
    "contact_of",
    "contacts",
    "controlled_env",
    "drive_out",
    "execute",
    "find_grasp_set",
    "find_strategy",
    "follow",
    "format_plan",
    "generate_grasps",
    "gripper_clearances",
    "gripper_opening",
    "gripper_poses",
    "heading",
    "held_object",
    "insert_robot",
    "is_covered",
    "label_of",
    "lower_bound",
    "map_parameters",
    "plan_contact",
    "prepare",
    "reachable_side_grasps",
    "release_pitch",
    "robot_arrays",
    "rotated",
    "scan_configurations",
    "solve",
    "stand_at",
    "standing_place",
    "tcp_pose",
    "validate",
    "warmup",
]
