"""Texts in the picture: the names of surfaces, and the ids of tags beside them."""

from collections.abc import Sequence
from typing import Any

from lmd.core.checks import FloatArray, IntArray
from lmd.space.surface import FLAT, Surface

NAME, ID, CHOSEN = 1.0, 0.75, 1.1  # sizes of letters, in those of viser
MOST_CAPTIONS = 120  # ids that would hide what they are beside


class Captions:
    """Labels of viser that follow a plan.

    Args:
        scene: of a server of viser.
        surfaces: those that are named.
    """

    def __init__(self, scene: Any, surfaces: Sequence[Surface]) -> None:
        self._scene = scene
        self._names = [_add_name(scene, surface) for surface in surfaces]
        self._ids: list[Any] = []
        self._shown: list[tuple[str, tuple[float, ...], bool, bool]] = []

    def show_names(self, visible: bool) -> None:
        """Show the names of the surfaces, or hide them."""
        for label in self._names:
            label.visible = visible

    def show_ids(self, ids: IntArray, places: FloatArray, selected: int | None, visible: bool) -> None:
        """Write the ids `(K,)` of tags at `places` `(K, 3)`; that of the selected one is larger and always visible."""
        for k, (number, place) in enumerate(zip(ids.tolist(), places.tolist(), strict=True)):
            self._show_id(k, (str(number), tuple(place), number == selected, visible or number == selected))
        for label in self._ids[len(ids) :]:
            label.visible = False
        del self._shown[len(ids) :]

    def _show_id(self, k: int, wanted: tuple[str, tuple[float, ...], bool, bool]) -> None:
        """Change a label, if it is not as it should be: there may be hundreds, and browsers are told of each."""
        if k == len(self._ids):
            self._ids.append(self._scene.add_label(f"/ids/{k}", "", anchor="bottom-center", visible=False))
        if k < len(self._shown) and self._shown[k] == wanted:
            return
        label, (label.text, label.position, chosen, label.visible) = self._ids[k], wanted
        label.font_screen_scale = CHOSEN if chosen else ID
        self._shown[k : k + 1] = [wanted]


def _add_name(scene: Any, surface: Surface) -> Any:
    """Name a wall below its lower edge, which is in sight also where the wall is not drawn; a floor in its middle."""
    is_level, (width, height) = abs(surface.normal[2]) > FLAT, surface.extent
    return scene.add_label(
        f"/names/{surface.name}",
        surface.name,
        position=surface.point(width / 2.0, height / 2.0 if is_level else 0.0),
        anchor="center-center" if is_level else "top-center",
        font_screen_scale=NAME,
    )
