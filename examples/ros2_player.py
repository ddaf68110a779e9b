"""Play a plan on a robot: a ROS 2 node that publishes the joint trajectory of a plan file, `solution.save("plan.npz")`.

python examples/ros2_player.py plan.npz /arm_controller/joint_trajectory    # in a shell with ROS 2 sourced
"""

import sys

import rclpy
from builtin_interfaces.msg import Duration
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from planners import Solution

plan = Solution.load(sys.argv[1]).to_joint_trajectory()
rclpy.init()
node = rclpy.create_node("plan_player")
publisher = node.create_publisher(JointTrajectory, sys.argv[2], 1)
message = JointTrajectory(joint_names=list(plan.joint_names))
for time, positions, velocities in zip(plan.times, plan.positions, plan.velocities, strict=True):
    after = Duration(sec=int(time), nanosec=int(1e9 * (time % 1)))
    message.points.append(
        JointTrajectoryPoint(positions=list(positions), velocities=list(velocities), time_from_start=after)
    )
# The base and the grippers have topics of their own on most robots: see plan.base and plan.gripper.
while not publisher.get_subscription_count():
    rclpy.spin_once(node, timeout_sec=0.1)
publisher.publish(message)
rclpy.spin_once(node, timeout_sec=1.0)
