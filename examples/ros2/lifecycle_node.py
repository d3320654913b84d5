"""A lifecycle node of ROS 2: as `lidar_core_node.py`, and obstacles for Nav2.

    source /opt/ros/jazzy/setup.bash
    python3 -m venv --system-site-packages venv && venv/bin/pip install 'lidar-core[io]'
    venv/bin/python lifecycle_node.py --ros-args -p scan:=/scan -p fixed_frame:=odom
    ros2 lifecycle set /lidar_core configure && ros2 lifecycle set /lidar_core activate

Parameters are those of `lidar_core_node.py`; they are read by `configure`. Between `activate` and
`deactivate` scans are processed; every activation begins with an empty map. Nav2's lifecycle
manager can bring it up with its own nodes.
"""

from threading import Thread

from lidar_core_node import NAME, loop_of
from nav2_obstacles import ObstacleOutput

from lidar_core import LidarCoreError

PARAMETERS = ("cloud", "scan", "odom", "fixed_frame", "pose")


class Lifecycle:
    """What the transitions do: each returns whether it succeeded, and never raises.

    `message_of` gives the class of a type, `quality_of` the quality of service of a topic.
    """

    def __init__(self, node, message_of, quality_of):
        self.node, self.message_of, self.quality_of = node, message_of, quality_of
        self.parameters = None
        self.loop = self.thread = self.error = None

    def configure(self, parameters):
        """Take over the parameters; refused if they name no scans, or contradict each other."""
        if bool(parameters.get("cloud")) == bool(parameters.get("scan")):
            return self._failed("expected one of the parameters cloud and scan")
        self.parameters = dict(parameters)
        return self._made()

    def activate(self):
        """Process scans, in a thread of its own."""
        if self.parameters is None or (self.loop is None and not self._made()):
            return False
        self.thread = Thread(target=self._work, args=(self.loop,), daemon=True)
        self.thread.start()
        return True

    def deactivate(self):
        """End processing; what is published last is whole."""
        if self.loop is not None:
            self.loop.inbox.finish()
        if self.thread is not None:
            self.thread.join()
        self.loop = self.thread = None
        return self.error is None

    def cleanup(self):
        """Forget the parameters."""
        self.deactivate()
        self.parameters = self.error = None
        return True

    def _made(self):
        try:
            self.loop = loop_of(
                self.node, self.parameters, self.message_of, self.quality_of, [ObstacleOutput]
            )
        except LidarCoreError as error:
            return self._failed(str(error))
        return True

    def _work(self, loop):
        try:
            loop.run()
        except Exception as error:  # the node stays, and says so when it is deactivated
            self._failed(f"processing ended: {error}")

    def _failed(self, reason):
        self.error = reason
        self.node.get_logger().error(reason)
        return False


def main():
    """Spin until ROS ends; transitions come from outside."""
    import rclpy
    from lidar_core_node import qualities
    from rclpy.executors import ExternalShutdownException
    from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
    from rosidl_runtime_py.utilities import get_message

    def told(is_done):
        done, failed = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE
        return done if is_done else failed

    class Managed(LifecycleNode):
        def __init__(self):
            super().__init__(NAME)
            for name in PARAMETERS:
                self.declare_parameter(name, "")
            self.work = Lifecycle(self, get_message, qualities())

        def on_configure(self, _):
            values = {name: self.get_parameter(name).value for name in PARAMETERS}
            return told(self.work.configure(values))

        def on_activate(self, state):
            super().on_activate(state)
            return told(self.work.activate())

        def on_deactivate(self, state):
            super().on_deactivate(state)
            return told(self.work.deactivate())

        def on_cleanup(self, _):
            return told(self.work.cleanup())

        def on_shutdown(self, _):
            return told(self.work.cleanup())

    rclpy.init()
    node = Managed()
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.work.cleanup()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
