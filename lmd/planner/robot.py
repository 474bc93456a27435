"""Robot in the picture: body, cameras, and handles that move a camera."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from lmd.cameras.body import Body
from lmd.core.checks import FloatArray, InputError
from lmd.geometry.camera import Camera
from lmd.geometry.projection import view_edges
from lmd.geometry.se3 import pose_of
from lmd.planner.actions import ActionQueue, call_in_order
from lmd.planner.session import PlanningSession
from lmd.planner.viewing import BODY, SEEN, framed
from lmd.scene.rig import OPTICAL, Mount, Rig

NONE, CAMERA = "none", "camera {}"  # texts of the choices of the camera to move
HINT = "choose a camera, then drag its arrows, squares and rings"
HANDLES_SHARE = 0.6  # length of the handles, relative to the depth of frustums
BODY_OPACITY = 0.5


class Robot:
    """Drawing of the body and its fixed cameras.

    Args:
        server: server of viser.
        depth: depth of the drawn frustums, metres.
        camera: initial camera or rig.
        body: body that carries the cameras; None if unknown.
    """

    def __init__(self, server: Any, depth: float, camera: Camera | Rig, body: Body | None) -> None:
        self._scene, self._depth = server.scene, depth
        self._frame = self._scene.add_frame("/robot", show_axes=False, visible=False)
        for i, (low, high) in enumerate(zip(*body.corners, strict=True) if body else ()):
            for name, opacity in (("box", BODY_OPACITY), ("edges", None)):
                self._scene.add_box(
                    f"/robot/{name}_{i}", BODY, high - low, position=(low + high) / 2.0, wireframe=name == "edges",
                    opacity=opacity, side="double", cast_shadow=False, receive_shadow=False,
                )  # fmt: skip
        mounts = camera.mounts if isinstance(camera, Rig) else (Mount(camera),)
        self._views = [
            self._scene.add_line_segments(f"/robot/camera_{i}", view_edges(mount.camera, depth), SEEN)
            for i, mount in enumerate(mounts)
        ]
        self._show_mounts(mounts)
        corners = np.vstack([*(body.corners if body else ()), *(mount.translation for mount in mounts)])
        self._radius = depth + float(np.linalg.norm(corners, axis=1).max())
        self.position: FloatArray | None = None
        self._turn: FloatArray = np.eye(3)
        self._number: int | None = None

    def stand(self, position: FloatArray, turn: FloatArray) -> None:
        """Move the body to a position `(3,)`, metres, and turn it by a rotation `(3, 3)`: ahead, left, up."""
        self._turn, self._frame.wxyz = turn, _quaternion(turn)
        self._frame.position, self._frame.visible, self.position = position, True, position

    @property
    def view(self) -> tuple[Camera, FloatArray]:
        """Chosen camera, else the first one, and its pose, camera to world, `(4, 4)`."""
        mount = self._mounts[self._number or 0]
        place = self.position + self._turn @ np.array(mount.translation)
        return mount.camera, pose_of(self._turn @ mount.rotation @ OPTICAL, place)

    def show(self) -> None:
        """Draw the present cameras; fixed cameras do not change."""

    def _show_mounts(self, mounts: tuple[Mount, ...]) -> None:
        self._mounts = mounts
        for view, mount in zip(self._views, mounts, strict=True):
            view.position, view.wxyz = mount.translation, _quaternion(mount.rotation @ OPTICAL)


class Rigging(Robot):
    """Drawing of the body and the cameras of a rig, which the user can move.

    Args:
        server: server of viser.
        depth: depth of the drawn frustums, metres.
        session: session with a rig.
        actions: queue for the user's actions.
        changed: called when a camera has moved.
    """

    def __init__(
        self, server: Any, depth: float, session: PlanningSession, actions: ActionQueue, changed: Callable[[], None]
    ) -> None:
        assert session.rig is not None, "there are cameras to move"
        super().__init__(server, depth, session.rig, session.space.body if session.space else None)
        self._session, self._actions, self._changed = session, actions, changed
        self._latest: Any = None  # last place and quaternion of the handles that are not applied yet
        self._is_held = False
        with server.gui.add_folder("Cameras"):
            self._text = server.gui.add_html("")
            names = [CAMERA.format(i) for i in range(len(self._views))]
            self._choice = server.gui.add_dropdown("move", (NONE, *names))
            self._look = server.gui.add_button("Look at the robot")
        positions = session.problem.evaluator.positions
        middle = np.linalg.norm(positions - positions.mean(axis=0), axis=1).argmin()
        self.stand(positions[middle], np.eye(3))
        self._handles = self._scene.add_transform_controls(
            "/robot/handles", HANDLES_SHARE * depth, depth_test=False, visible=False
        )
        actions.on(self._choice.on_update, self._choose)
        actions.on(self._look.on_click, self._look_at)
        call_in_order(self._handles.on_update, self._hold)

    def show(self) -> None:
        """Draw the present cameras and handles."""
        rig = self._session.rig
        assert rig is not None, "there are cameras to move"
        self._show_mounts(rig.mounts)
        self._handles.visible = self._number is not None
        text = HINT
        if self._number is not None:
            mount = rig.mounts[self._number]
            x, y, z = mount.translation
            yaw, pitch, roll = np.degrees([mount.yaw, mount.pitch, mount.roll])
            text = f"{CAMERA.format(self._number)}: ({x:.3f}, {y:.3f}, {z:.3f}) m, yaw {yaw:.1f}, pitch {pitch:.1f}, "
            text += f"roll {roll:.1f} degrees"
            if not self._is_held:
                self._handles.position, self._handles.wxyz = mount.translation, _quaternion(mount.rotation)
        self._text.content = f'<p id="camera" style="font-size: 0.85em; margin: 0.4em 1em">{text}</p>'

    def _choose(self, _: Any) -> None:
        names = self._choice.options[1:]
        self._number = names.index(self._choice.value) if self._choice.value in names else None
        self._changed()

    def _look_at(self, event: Any) -> None:
        assert self.position is not None, "it stands somewhere"
        place = framed(self.position - self._radius, self.position + self._radius, event.client.camera.aspect)
        event.client.camera.position, event.client.camera.look_at = place

    def _hold(self, event: Any) -> None:
        """Record a drag, in viser's thread; only the last place matters."""
        self._latest = event.target.position, event.target.wxyz
        self._actions.put_answer(partial(self._follow, event.phase == "end"))

    def _follow(self, ends: bool) -> None:
        latest, self._latest = self._latest, None
        self._is_held = not ends
        try:
            if latest is not None and self._number is not None:
                self._session.mount(self._number, np.asarray(latest[0]), _turn(latest[1]))
                self._changed()
        finally:
            if ends:
                self._session.drop()
                self.show()


def robot_of(
    server: Any, depth: float, session: PlanningSession, actions: ActionQueue, changed: Callable[[], None]
) -> Robot:
    """Robot of a session: a `Rigging` if its cameras can be moved, else a `Robot`."""
    if session.rig is None:
        return Robot(server, depth, session.problem.scene.camera, None)
    return Rigging(server, depth, session, actions, changed)


def _quaternion(turn: FloatArray) -> FloatArray:
    """Quaternion w, x, y, z of a rotation `(3, 3)`."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(turn).as_quat(scalar_first=True))


def _turn(wxyz: Any) -> FloatArray:
    """Rotation `(3, 3)` of a quaternion w, x, y, z that a browser has sent.

    Raises:
        InputError: the quaternion is no rotation.
    """
    from scipy.spatial.transform import Rotation

    try:
        return np.asarray(Rotation.from_quat(wxyz, scalar_first=True).as_matrix())
    except ValueError:
        raise InputError("that is no rotation.") from None
