"""The `model` parameter: what is loaded, asked for and refused; the arm as the model sees it."""

from __future__ import annotations

from geometry_msgs.msg import PoseArray, PoseStamped
from rclpy.node import Node
from std_msgs.msg import Header
from visualization_msgs.msg import MarkerArray

from ...common.colours import PREDICTED
from ...common.errors import TendonRobotError
from ...control.checks import check_inputs
from ...control.loading import Loader
from ...effects import load_catalogue
from ...model.model import Model
from ...model.shape import Shape
from ...robot import load_robot
from ...robot.description import DESCRIPTION_MAX
from ...robot.loading import robot_file
from ..shared.messages import (
    STATE,
    arm_markers,
    passing_publisher,
    pose_array,
    pose_stamped,
)
from ..shared.parameters import Parameters

READ_AT_ONCE_MAX = 4_000  # characters that are read before the parameter is accepted


class ModelLoading:
    """Loads the model that the parameter names; another one at run time."""

    def __init__(self, parameters: Parameters) -> None:
        """Begin with what the node was started with."""
        self._parameters = parameters
        self._loader: Loader | None = None
        self._in_use = self._wanted = self._taken = ''
        self._inputs: tuple[str, ...] = ()  # of the model in use
        self.asked = False  # another model, at run time
        self.note = ''
        self._begun()

    @property
    def doing(self) -> str:
        """What takes so long: loading, compiling or building."""
        return self._begun().doing

    @property
    def done(self) -> bool:
        """Whether `result` returns soon; asking begins to load."""
        return self._begun().done

    def forget(self) -> None:
        """Load what the parameter says the next time."""
        self.cancel()
        self._loader, self._inputs, self.asked = None, (), False

    def change(self, text: str) -> None:
        """Begin to load another model; raise what is quickly found wrong with it."""
        if _short(text):
            robot = load_robot(text)
            if self._inputs:
                check_inputs(robot.inputs, self._inputs)
            if not self._parameters['effects']:
                catalogue = load_catalogue([])
                for name in robot.effects:
                    catalogue[name]
        self.cancel()
        self._loader, self._wanted, self.asked = self._begin(text), text, True

    def result(self) -> Model:
        """Return the model; raise when there is none."""
        loader = self._begun()
        self.asked, self._taken = False, self._wanted
        try:
            return loader.result()
        except TendonRobotError:
            if not self._inputs:
                self.forget()  # the file may be right the next time
            raise

    def accept(self, model: Model) -> None:
        """Keep the model that was taken last."""
        self._in_use, self._inputs = self._taken, model.inputs
        self.note = f'{model.robot.name} ({", ".join(model.robot.effects) or "PCCA"})'

    def refuse(self) -> None:
        """Go back to the model before: the parameter names the one in use, or one to come."""
        if not self.asked:
            self._parameters.put_back('model', self._in_use)

    def cancel(self) -> None:
        """End what is being loaded."""
        if self._loader is not None:
            self._loader.cancel()

    def _begun(self) -> Loader:
        if self._loader is None:
            self._in_use = self._wanted = self._parameters['model']
            self._loader = self._begin(self._wanted)
        return self._loader

    def _begin(self, text: str) -> Loader:
        return Loader(lambda: load_robot(text), self._parameters['effects'], self._inputs)


def _short(text: str) -> bool:
    """Whether a description is read, or refused, in no time."""
    file = robot_file(text)
    if file is None:
        return not READ_AT_ONCE_MAX < len(text) <= DESCRIPTION_MAX
    if not file.exists():
        return True
    return file.is_file() and not READ_AT_ONCE_MAX < file.stat().st_size <= DESCRIPTION_MAX


# -----------------------------------------------------------------------------
# Publishing the arm as the model sees it.


class Prediction:
    """Shape, tip and markers of the predicted arm."""

    def __init__(self, node: Node, frame: str, model: Model) -> None:
        """Make the publishers."""
        self._node = node
        self.use(frame, model)
        self._shape = passing_publisher(node, PoseArray, '~/predicted_shape', STATE)
        self._tip = passing_publisher(node, PoseStamped, '~/predicted_tip', STATE)
        self._markers = passing_publisher(node, MarkerArray, '~/markers', STATE)

    def use(self, frame: str, model: Model) -> None:
        """Draw the robot of a model, in a frame."""
        self._frame = frame
        offsets = [abs(value) for t in model.robot.tendons for value in (*t.base, *t.end)]
        self._thickness = 2.0 * max(offsets)

    def publish(self, shape: Shape) -> None:
        """Publish a shape; poses are the distal ends of the cells."""
        header = Header(frame_id=self._frame, stamp=self._node.get_clock().now().to_msg())
        if self._shape.get_subscription_count():
            self._shape.publish(pose_array(header, shape.positions, shape.frames))
        if self._tip.get_subscription_count():
            self._tip.publish(pose_stamped(header, shape.tip_position, shape.frames[-1]))
        if self._markers.get_subscription_count():
            self._markers.publish(
                arm_markers(header, shape.positions, self._thickness, PREDICTED, 'predicted')
            )

    def close(self) -> None:
        """Stop to publish."""
        for publisher in (self._shape, self._tip, self._markers):
            self._node.destroy_publisher(publisher)
