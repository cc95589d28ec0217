"""What a method does in a frame, counted: its rays and the bytes that it moves. The floor is measured from this."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import mitsuba as mi

if TYPE_CHECKING:
    from luxel.scene.device import Scene


class Workload:
    """Counts the work of one method; as it stands, that of a method which casts no ray and keeps no state."""

    def ray_counts(self, state: Any) -> dict[str, int]:
        """Rays a frame at most, by kind: `closest`, `shadow`, `sky` for shadow rays that look for the sky, and `short`.

        Short rays end after a length of the cache's own, and bring no light.
        """
        return {}

    def ray_origins(self, scene: Scene, state: Any) -> tuple[mi.Point3f, mi.Normal3f, mi.Bool] | None:
        """World points, normals and activity of the method's own rays, one lane a ray; None where it casts none.

        The floor is measured with bare casts from there.
        """
        return None

    def ray_directions(self, scene: Scene, state: Any) -> mi.Vector3f | None:
        """World unit directions of those rays, lane by lane; None: spread by the cosine about the normals."""
        return None

    def touched_bytes(self, state: Any) -> int:
        """Bytes of its state that a frame must read and write."""
        return 0
