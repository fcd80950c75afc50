"""A node of ROS 2 that denoises the images of a sonar as they come.

python examples/ros2_denoise.py /sonar/image
python examples/ros2_denoise.py /oculus/sonar_image --sonar

The first is for a topic of sensor_msgs/Image, whose fan is found in the first image; the second
for one of marine_acoustic_msgs/ProjectedSonarImage, which says where its samples lie.  The same
messages with denoised samples come out on TOPIC/denoised.  Of the images that come while one is
denoised, only the last waits.  Needs a sourced ROS 2 and `pip install 'simnfnd[train]'`.
"""

import argparse

from simnfnd import FactoryError
from simnfnd.factory.common.ros_types import SONAR
from simnfnd.models.denoise.denoiser import Denoiser
from simnfnd.models.denoise.images import Denoising
from simnfnd.models.recordings.fan_finder import find_geometry
from simnfnd.models.recordings.rosbag import IMAGE, frame_of, with_samples
from simnfnd.models.recordings.views import polar_geometry


class Worker:
    """Messages in, denoised messages out; knows nothing of ROS."""

    def __init__(self, kind, weights=None):
        """kind: type of the messages, as bags call it."""
        self.kind = kind
        self.denoising = Denoising(Denoiser(weights))
        self.count = 0
        self.fans = {}

    def __call__(self, message):
        """The message with denoised samples.  Raises FactoryError, or ValueError for odd floats."""
        label = f"message {self.count}"
        self.count += 1
        frame = frame_of(message, self.kind, self.count, 0.0, label)
        if frame.beams is not None:
            geometry = polar_geometry(frame.beams, len(frame.samples))
        else:
            shape = frame.samples.shape
            if shape not in self.fans:
                self.fans[shape] = find_geometry(frame.samples)
            geometry = self.fans[shape]
        denoised = self.denoising.denoise_image(frame.samples, lambda image: geometry).image
        return with_samples(message, self.kind, denoised, label)


def main():
    """Run the node until Ctrl-C."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("topic")
    parser.add_argument("--sonar", action="store_true", help="of ProjectedSonarImage, not Image")
    parser.add_argument("--weights", help="weights.safetensors of a training")
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

    worker = Worker(SONAR if options.sonar else IMAGE, options.weights)
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
