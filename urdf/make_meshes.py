"""Make every visual mesh of the arm: ``python -m urdf.make_meshes``, from the project's root.

Deterministic: the same manifold3d gives the same bytes, and a test holds one part to that. Needs
the development dependencies; takes about half a minute. What a part looks like is laid out in
``generator/links.py`` and ``generator/servo.py``.
"""

import sys
import time
from pathlib import Path
from typing import Final

from .generator.glb import GlbSize, Material, write_glb
from .generator.links import LINKS
from .generator.markers import MARKERS

MATERIALS: Final = {
    material.name: material
    for material in (
        Material(name="print", srgb=(245, 138, 36)),
        Material(name="accent", srgb=(244, 244, 241)),
        Material(name="servo", srgb=(34, 34, 38), roughness=0.5),
        Material(name="horn", srgb=(96, 98, 104), metallic=0.5, roughness=0.45),
        Material(name="x", srgb=(220, 50, 47)),
        Material(name="y", srgb=(60, 170, 70)),
        Material(name="z", srgb=(50, 100, 220)),
    )
}


def make(part: str, folder: Path) -> GlbSize:
    """Make one part's file.

    Args:
        part: A key of ``LINKS`` or ``MARKERS``.
        folder: Where ``<part>.glb`` is written.

    Returns:
        The size of the file.
    """
    solids = (LINKS | MARKERS)[part]()
    return write_glb(
        folder / f"{part}.glb", [(MATERIALS[name], solid) for name, solid in solids.items()]
    )


def main() -> None:
    """Make the parts named on the command line, or all of them."""
    folder = Path(__file__).resolve().parent / "meshes"
    sizes: list[GlbSize] = []
    for part in sys.argv[1:] or [*LINKS, *MARKERS]:
        begin = time.perf_counter()
        size = make(part, folder)
        sizes.append(size)
        seconds = time.perf_counter() - begin
        print(f"{part:15}{size.triangles:7d} triangles{size.size_bytes:9d} bytes{seconds:7.1f} s")
    triangles, size_bytes = sum(s.triangles for s in sizes), sum(s.size_bytes for s in sizes)
    print(f"{'together':15}{triangles:7d} triangles{size_bytes:9d} bytes")


if __name__ == "__main__":
    main()
