"""The display as a ROS 2 node: joint states out; a wall, a spring and friction levels in.

python3 examples/worlds/ros2_node.py [BUS]                    beside `coulombus run --world`

| topic | message | meaning |
|---|---|---|
| /handle/joint_states | sensor_msgs/JointState | position [rad], velocity [rad/s], effort of the hand [Nm] |
| /handle/wall | std_msgs/Float64MultiArray | x_rad, K_Nm_rad, B_Nms_rad |
| /handle/spring | std_msgs/Float64MultiArray | x_rad, K_Nm_rad, B_Nms_rad |
| /handle/friction | std_msgs/Float64MultiArray | F_s_Nm, F_d_Nm |

What a topic has said holds for `LIFE_S`. A publisher that is gone leaves the rig's law.
"""

import sys
import time

from coulombus import Model, Spring, Wall, connect

RATE_HZ = 200.0
LIFE_S = 0.2
JOINT = "handle"
PARTS = {"wall": Wall, "spring": Spring}


def joint_state(state):
    """Return the fields of a sensor_msgs/JointState, without its stamp."""
    return {"name": [JOINT], "position": [state.x_rad], "velocity": [state.v_rad_s], "effort": [state.handle_Nm]}


class Commands:
    """The newest message of each topic, until it is too old."""

    def __init__(self):
        self._newest = {}

    def update(self, topic, numbers, now_s):
        """Keep a message; return the reason why not, or None."""
        count = 2 if topic == "friction" else 3
        if len(numbers) != count:
            return f"{topic}: expected {count} numbers, got {len(numbers)}"
        self._newest[topic] = now_s, tuple(map(float, numbers))
        return None

    def model(self, now_s):
        """Return what the hand meets now."""
        said = {topic: numbers for topic, (at_s, numbers) in self._newest.items() if now_s - at_s <= LIFE_S}
        parts = {topic: PARTS[topic](*numbers) for topic, numbers in said.items() if topic in PARTS}
        levels = dict(zip(("F_s_Nm", "F_d_Nm"), said.get("friction", ()), strict=False))
        return Model(**parts, parameters=levels, life_s=LIFE_S)


def main(bus="coulombus:bench"):
    """Run until ROS or the host ends."""
    import rclpy
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64MultiArray

    rclpy.init()
    node, commands = rclpy.create_node("coulombus"), Commands()
    states = node.create_publisher(JointState, f"{JOINT}/joint_states", 10)

    def listen(topic):
        def update(message):
            reason = commands.update(topic, message.data, time.monotonic())
            if reason is not None:
                node.get_logger().warning(reason)

        node.create_subscription(Float64MultiArray, f"{JOINT}/{topic}", update, 10)

    for topic in (*PARTS, "friction"):
        listen(topic)
    with connect(bus) as hand:

        def tick():
            message = JointState(**joint_state(hand.state))
            message.header.stamp = node.get_clock().now().to_msg()
            states.publish(message)
            hand.render(commands.model(time.monotonic()))

        node.create_timer(1.0 / RATE_HZ, tick)
        rclpy.spin(node)


if __name__ == "__main__":
    main(*sys.argv[1:2])
