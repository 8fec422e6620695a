"""The live page: a scene and a panel in the browser, by viser; no ROS in here."""

from __future__ import annotations

import hmac
import queue
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...common.arrays import Floats
from ...common.colours import BAD, ERROR, GOOD, INK, MEASURED, ORANGE, PREDICTED, rgb
from ...common.errors import DriverError, of_extra
from . import page_parts
from .state import ViewState

BUTTONS: tuple[tuple[str, str, str, str], ...] = (  # name, label, hint, colour
    ('record', '1  Record', 'every posture in which the arm stands still', ORANGE),
    ('diagnose', '2  Diagnose', 'which physical effect is missing?', PREDICTED),
    ('add', '3  Add what was found', 'to the model of the running controller', GOOD),
    ('start', 'Investigate', 'the arm chooses its postures by itself, until it knows', INK),
    ('stop', 'STOP', 'release the arm; not a safety-rated stop', BAD),
    ('reset', 'Reset', 'after a stop', ERROR),
)
# [1] of the robot's length: the measured arm is wide and translucent, the predicted one a third of
# that, so that both are visible where they coincide
MEASURED_WIDTH = 0.034
# [1] viewing direction: from the side, so that bends in the plane x-z are undistorted, and
# slightly from above, so that the grid is visible
ALONG = np.array([0.0, 0.99, -0.14])
# [1] of the height of a phone that viser's panel may cover, at the lower edge: `max-height` in its
# manual; on a desktop the panel is docked beside the scene
PANEL_OF_PHONES = 0.6
# [1] width over height of a scene, below which it is a phone's, because desktops are wider
PHONE_ASPECT = 0.8
# [rad] default of viser, and [1] width over height, because no browser has told its own yet
DESKTOP = float(np.deg2rad(75.0)), 4.0 / 3.0


@dataclass(frozen=True)
class View:
    """A camera: its position and the point at the centre of its image, (3,) [m] each."""

    position: Floats
    look_at: Floats


def framed(radius: float, fov: float, aspect: float) -> View:
    """
    Return the closest view of a ball about the base that the panel does not cover.

    The radius is the length of the arm: no part of it is farther from its base, however it bends.
    The ball touches a side of the free part of the image from within where its distance to the
    plane through the camera and that side is the radius. Two opposite sides determine the
    distance of the camera, and the place of the ball between them.

    Parameters
    ----------
    radius : float [m]
    fov : float [rad]
        Vertical field of view.
    aspect : float
        Width over height of the image.

    """
    half = np.tan(0.5 * fov)
    lowest = 2.0 * PANEL_OF_PHONES - 1.0 if aspect < PHONE_ASPECT else -1.0
    sides = half * np.array([[-aspect, aspect], [lowest, 1.0]])  # at depth 1
    margins = radius * np.sqrt(1.0 + sides**2)
    depth = float((margins.sum(axis=1) / (sides[:, 1] - sides[:, 0])).max())
    across = 0.5 * (sides.sum(axis=1) * depth + margins[:, 0] - margins[:, 1])
    along = ALONG / np.linalg.norm(ALONG)
    right = np.cross(along, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, along)
    position = -across[0] * right - across[1] * up - depth * along
    return View(position, position + depth * along)


class LivePage:
    """
    Serves the page; `commands` is a queue of clicks, as (name, value).

    Parameters
    ----------
    host, port : str, int
        Address and port; commands from other machines need the token.
    token : str
        Empty: every browser that opens the page may command.
    size : float
        Length of the robot [m], until `resize` changes it.

    """

    def __init__(self, host: str, port: int, token: str, size: float = 1.0) -> None:
        """Open the port."""
        viser = of_extra('viewer', 'viser')
        try:
            self._server = viser.ViserServer(host=host, port=port, verbose=False)
        except OSError as error:
            raise DriverError(f'port {port}: {error.strerror}; choose another port') from None
        self.port = int(self._server.get_port())  # in use
        self.commands: queue.SimpleQueue[tuple[str, Any]] = queue.SimpleQueue()
        self._token, self._allowed, self._size = token, set[int](), size
        self._views: dict[int, View] = {}  # client -> where its camera was placed
        self._scene()
        self._panel()
        self._server.on_client_connect(self._welcome)

    @property
    def clients(self) -> int:
        """Number of connected browsers."""
        return len(self._server.get_clients())

    def close(self) -> None:
        """Close the port."""
        self._server.stop()

    def resize(self, size: float) -> None:
        """Adapt the scene to another length [m]; `update` then places the cameras."""
        if size == self._size:
            return
        for thing in self._drawn.values():
            thing.remove()
        self._size = size
        self._scene()
        self._boxes['legend'].content = page_parts.legend(self._square)

    def draw(self, state: ViewState) -> None:
        """Update the arms in the scene."""
        with self._server.atomic():
            if len(state.measured):
                self._tube(_nodes(state.measured))
                if np.isfinite(tip := state.measured[-1]).all() and not state.held:
                    self._target.position = tuple(tip.tolist())
            if len(state.predicted):
                nodes = _nodes(state.predicted)
                self._line('predicted', np.stack([nodes[:-1], nodes[1:]], axis=1))
            if len(errors := state.errors()):
                self._line('error', errors)
            self._line('force', state.force_line(time.monotonic()))

    def update(self, state: ViewState, now: float) -> None:
        """Update the panel; only changes are sent."""
        for client in self._server.get_clients().values():
            self._frame(client)
        contents = {
            'scene': page_parts.scene(state.measured, state.predicted),
            'statuses': page_parts.statuses(state.statuses(now)),
            'error': page_parts.big_error(state.rolling(now), state.per_marker()),
            'curve': page_parts.curve(state, now),
            'bars': page_parts.bars(state.inputs, state.tensions, *state.limits),
            'verdict': page_parts.verdict(state.verdict),
            'investigation': page_parts.investigation(state.investigation),
            'guide': page_parts.guide(state.guide(), state.progress),
        }
        for name, content in contents.items():  # viser sends what differs
            self._boxes[name].content = content
        self._buttons['record'].label = state.record_label
        self._buttons['reset'].visible = state.stopped
        for name, on in state.ready.items():
            self._buttons[name].disabled = not on
        if self._tour.value != state.touring:
            self._tour.value = state.touring

    def _scene(self) -> None:
        scene, size = self._server.scene, self._size
        scene.set_up_direction('+z')
        camera = self._server.initial_camera
        self._first = framed(self._radius, *DESKTOP)
        camera.position, camera.look_at = self._first.position, self._first.look_at
        camera.near = 0.01 * size
        self._square = page_parts.round_length(0.15 * size)
        whole, square = 2.0 * size, self._square
        scene.add_grid(
            '/grid', width=whole, height=whole, cell_size=square, section_size=5.0 * square
        )
        self._drawn: dict[str, Any] = {}  # the lines, and the tube
        self._target = scene.add_transform_controls(
            '/target',
            scale=0.22 * size,
            line_width=3.0,
            disable_rotations=True,
            disable_sliders=True,
        )
        self._target.on_update(self._guarded('target', lambda: np.array(self._target.position)))

    def _line(self, name: str, segments: Floats) -> None:
        """Show segments (s, 2, 3) [m]; while their number stays, only the points are sent."""
        points = segments.astype(np.float32)
        line = self._drawn.get(name)
        if line is not None and line.points.shape == points.shape:
            line.points = points
            return
        colour = rgb({'predicted': PREDICTED, 'error': ERROR, 'force': GOOD}[name])
        thickness = (MEASURED_WIDTH / 3.0 if name == 'predicted' else 0.004) * self._size
        self._drawn[name] = self._server.scene.add_line_segments(
            f'/{name}', points, colour, thickness=thickness, thickness_units='world'
        )

    def _tube(self, nodes: Floats) -> None:
        """Show the measured arm through nodes (n, 3) [m] as a wide, translucent tube."""
        if len(nodes) < 2:
            return
        vertices = page_parts.tube_vertices(nodes, 0.5 * MEASURED_WIDTH * self._size)
        tube = self._drawn.get('measured')
        if tube is not None and tube.vertices.shape == vertices.shape:
            tube.vertices = vertices
            return
        self._drawn['measured'] = self._server.scene.add_mesh_simple(
            '/measured',
            vertices,
            page_parts.tube_faces(len(nodes)),
            color=rgb(MEASURED),
            opacity=page_parts.MEASURED_OPACITY,
            cast_shadow=False,
            receive_shadow=False,
        )

    def _panel(self) -> None:
        gui = self._server.gui
        gui.configure_theme(control_width='large', show_logo=False, show_share_button=False)
        panel = getattr(gui, 'main_panel', None)  # viser 1.0 has none
        if panel is not None:
            panel.dock_right()
        gui.set_panel_label('tendon robot, live')
        self._boxes: dict[str, Any] = {'legend': gui.add_html(page_parts.legend(self._square))}
        for name in ('scene', 'error', 'curve', 'guide'):
            self._boxes[name] = gui.add_html('')
        self._buttons: dict[str, Any] = {}
        for name, label, hint, colour in BUTTONS:
            if name == 'stop':
                gui.add_html(f'<div id="{page_parts.STOP_MARK}"></div>')
            button = gui.add_button(label, hint=hint, color=rgb(colour))
            button.on_click(self._guarded(name, lambda: None))
            self._buttons[name] = button
        for name in ('investigation', 'verdict', 'bars'):
            self._boxes[name] = gui.add_html('')
        self._tour: Any = gui.add_checkbox('tour through postures', True)
        self._tour.on_update(self._guarded('tour', lambda: bool(self._tour.value)))
        self._boxes['statuses'] = gui.add_html('')

    def _guarded(self, name: str, value: Callable[[], Any]) -> Callable[[Any], None]:
        """Return a callback that queues a command if its browser is authorised."""

        def clicked(event: Any) -> None:
            if event.client_id is None:  # the value was set by this program
                return
            if self._token and event.client_id not in self._allowed:
                if event.client is not None:
                    event.client.add_notification(
                        'No token', 'Commands from this page need the token.', color='red'
                    )
                return
            self.commands.put((name, value()))

        return clicked

    def _welcome(self, client: Any) -> None:
        """Place the camera of a new browser; request the token, if there is one."""
        self._frame(client)
        if not self._token:
            return
        field = client.gui.add_text('token', '', order=-1.0)

        def typed(event: Any) -> None:
            if hmac.compare_digest(field.value.encode(), self._token.encode()):
                self._allowed.add(client.client_id)
                field.remove()

        field.on_update(typed)

    def _frame(self, client: Any) -> None:
        """Place a camera that nobody has moved so that the whole workspace is visible."""
        camera = client.camera
        view = framed(self._radius, camera.fov, camera.image_width / camera.image_height)
        last = self._views.get(client.client_id)
        moved = last is not None and not (
            self._is_at(client, last) or self._is_at(client, self._first)
        )
        if moved:
            return
        self._views[client.client_id] = view
        if not self._is_at(client, view):
            camera.position, camera.look_at = view.position, view.look_at

    def _is_at(self, client: Any, view: View) -> bool:
        """Return whether a camera is at a view, as near as the drawn arm is thin."""
        distance = np.linalg.norm(client.camera.position - view.position)
        return bool(distance < 0.5 * MEASURED_WIDTH * self._size)

    @property
    def _radius(self) -> float:
        """Largest distance of the drawn arm from the base, its width included [m]."""
        return (1.0 + 0.5 * MEASURED_WIDTH) * self._size


def _nodes(points: Floats) -> Floats:
    """Return the base and the finite points, (n, 3) [m]."""
    return np.vstack([np.zeros((1, 3)), points[np.isfinite(points).all(axis=1)]])
