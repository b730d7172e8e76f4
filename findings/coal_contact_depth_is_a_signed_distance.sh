#!/bin/sh
# coal 3.0.3: Contact.penetration_depth.
#
# Expected: how deep two bodies are in each other, positive when they overlap.
# Seen: the signed distance, so -0.010 for an overlap of 10 mm, and +0.015 for a sphere that is 15 mm
# away and was reported because of a security margin. A filter "depth > 0 means contact" keeps
# what is apart and drops what overlaps.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet coal==3.0.3 "numpy<3"
"$folder/venv/bin/python" - <<'PY'
import coal
import numpy as np

sphere, box = coal.Sphere(0.05), coal.Box(0.1, 0.1, 0.1)
depths = {}
for gap in (0.015, -0.010):
    place = coal.Transform3s()
    place.setTranslation(np.array([0.1 + gap, 0.0, 0.0]))
    request, result = coal.CollisionRequest(), coal.CollisionResult()
    request.security_margin = 0.03
    coal.collide(sphere, place, box, coal.Transform3s(), request, result)
    depths[gap] = result.getContact(0).penetration_depth
    print(f"gap {1000 * gap:+.0f} mm: penetration_depth {1000 * depths[gap]:+.1f} mm")
assert all(np.isclose(depth, gap, atol=1e-6) for gap, depth in depths.items())
PY
