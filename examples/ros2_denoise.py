"""A node of ROS 2 that denoises the images of a sonar as they come.

python examples/ros2_denoise.py /sonar/image
python examples/ros2_denoise.py /oculus/sonar_image --sonar

The first is for a topic of sensor_msgs/Image, whose fan is found in the images; the second for one
of marine_acoustic_msgs/ProjectedSonarImage, which says where its samples lie.  The same messages
with denoised samples come out on TOPIC/denoised, each fused with the frames before it.  Of the
messages that come while one is denoised, only the last waits.  Needs a sourced ROS 2 and
`pip install 'simnfnd[denoise,sonar,ros]'`; torch only for weights of your own.
"""

import argparse

from simnfnd import Denoiser, FactoryError
from simnfnd.factory.common.ros_types import SONAR
from simnfnd.models.recordings.rosbag import IMAGE, frame_of, with_samples


class Worker:
    """Messages in, denoised messages out; knows nothing of ROS."""

    def __init__(self, kind, weights=None, frames=7):
        """kind: type of the messages, as bags call it.  frames: fused at most, odd."""
        self.kind = kind
        self.stream = Denoiser(weights=weights, frames=frames)
        self.count = 0

    def __call__(self, message):
        """The message with denoised samples.  Raises FactoryError, or ValueError for odd floats."""
        label = f"message {self.count}"
        frame = frame_of(message, self.kind, self.count, 0.0, label)
        self.count += 1
        return with_samples(message, self.kind, self.stream(frame), label)


def main():
    """Run the node until Ctrl-C."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("topic")
    parser.add_argument("--sonar", action="store_true", help="of ProjectedSonarImage, not Image")
    parser.add_argument("--weights", help="weights.safetensors of a training")
    parser.add_argument("--frames", type=int, default=7, help="fused at most (1: each alone)")
    options, ros = parser.parse_known_args()

    # Only here: the rest of this file needs no ROS.
    try:
        import rclpy
        from rclpy.qos import QoSProfile, ReliabilityPolicy
    except ModuleNotFoundError as error:
        parser.error(f"{error}; source the setup.bash of ROS 2 first")

    if options.sonar:
        from marine_acoustic_msgs.msg import ProjectedSonarImage as Message
    else:
        from sensor_msgs.msg import Image as Message

    worker = Worker(SONAR if options.sonar else IMAGE, options.weights, options.frames)
    rclpy.init(args=ros)
    node = rclpy.create_node("simnfnd_denoise")
    publisher = node.create_publisher(Message, f"{options.topic}/denoised", 1)
    # Hears publishers of either reliability.
    latest = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)

    def on(message):
        try:
            publisher.publish(worker(message))
        except (FactoryError, ValueError) as error:
            node.get_logger().warning(f"left out: {error}")

    node.create_subscription(Message, options.topic, on, latest)
    node.get_logger().info(f"{options.topic} -> {options.topic}/denoised")
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
