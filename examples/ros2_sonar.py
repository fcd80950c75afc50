"""A node of ROS 2 that publishes a simulated sonar, live.

python examples/ros2_sonar.py circle --rate 5 sonar=oculus_c550d_hf
python examples/ros2_sonar.py dive.csv scenes.first_location=3

Topics are those of `simnfnd stream`: /sonar/noisy (ProjectedSonarImage), /sonar/noisy/image,
/sonar/points, /sonar/labels, /sonar/pose, /tf and /tf_static.  Needs a sourced ROS 2 with
marine_acoustic_msgs and `pip install 'simnfnd[sonar,ros]'`.
"""

import argparse
from array import array
from importlib import import_module

import numpy as np

from simnfnd import Sonar
from simnfnd.factory.production.export.ping_messages import PingMessages
from simnfnd.factory.simulation.pings.trajectories import poses_of


class RosTypes(dict):
    """Classes of a running ROS by the names of their messages, such as sensor_msgs/msg/Image."""

    def __missing__(self, name):
        package, _, kind = name.split("/")
        message_class = getattr(import_module(f"{package}.msg"), kind)

        def build(**fields):
            return message_class(**{key: plain(value) for key, value in fields.items()})

        self[name] = build
        return build


def plain(value):
    """Arrays of NumPy as ROS takes them."""
    if not isinstance(value, np.ndarray):
        return value
    return array("B" if value.dtype == "uint8" else "f", value.tobytes())


def main():
    """Publish until the trajectory ends, or Ctrl-C."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("path", help="line, circle, lawnmower, or a CSV file of poses")
    parser.add_argument("--rate", type=float, default=5.0, help="pings a second")
    parser.add_argument("--count", type=int, default=1000, help="pings along a shape")
    parser.add_argument("settings", nargs="*", metavar="KEY=VALUE", help="as for simnfnd make")
    options = parser.parse_intermixed_args()

    # Only here: the rest of this file needs no ROS.
    try:
        import rclpy
        from rclpy.qos import DurabilityPolicy, QoSProfile
    except ModuleNotFoundError as error:
        parser.error(f"{error}; source the setup.bash of ROS 2 first")

    rclpy.init()
    node = rclpy.create_node("simnfnd_sonar")
    publishers = {}
    poses = iter(
        poses_of(options.path, "seabed", count=options.count, rate_hz=options.rate, speed_m_s=0.5)
    )
    sonar = Sonar("seabed", overrides=options.settings)
    messages = PingMessages(sonar, RosTypes())
    pings = enumerate(poses)

    def publish():
        try:
            index, (time_s, pose) = next(pings)
        except StopIteration:
            rclpy.try_shutdown()
            return
        now_s = node.get_clock().now().nanoseconds / 1e9
        for topic, _, message in messages.of(sonar.ping(pose, index=index, time_s=time_s), now_s):
            if topic not in publishers:
                keep = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
                quality = keep if topic == "/tf_static" else 10
                publishers[topic] = node.create_publisher(type(message), topic, quality)
            publishers[topic].publish(message)

    node.create_timer(1 / options.rate, publish)
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        pass
    finally:
        sonar.close()
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
