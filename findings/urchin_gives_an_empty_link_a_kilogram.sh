#!/bin/sh
# urchin 0.0.30 (the maintained successor of urdfpy): URDF.load and save.
#
# Expected: a link without <inertial>, such as the frame of a tool or of a camera, has no mass, in memory and when written.
# Seen: each gets 1 kg and 1 kg m^2. An arm of 0.5 kg with three such frames weighs 3.5 kg once it was read and written, without a
# message; a simulator or a gravity compensation that is given the file carries the rest. Joints, axes and mimics are as they were.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet urchin==0.0.30
cat > "$folder/arm.urdf" <<'URDF'
<robot name="arm">
  <link name="base"/>
  <link name="upper_arm">
    <inertial><mass value="0.5"/><inertia ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <link name="tool"/>
  <link name="camera"/>
  <joint name="shoulder" type="revolute">
    <parent link="base"/><child link="upper_arm"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/>
  </joint>
  <joint name="flange" type="fixed"><parent link="upper_arm"/><child link="tool"/><origin xyz="0 0 0.2"/></joint>
  <joint name="mount" type="fixed"><parent link="tool"/><child link="camera"/><origin xyz="0 0.03 0"/></joint>
</robot>
URDF
cd "$folder"
venv/bin/python - <<'PY'
from xml.etree import ElementTree

from urchin import URDF


def masses(file):
    links = ElementTree.parse(file).findall("link")
    return {link.get("name"): float(mass.get("value")) for link in links for mass in link.iterfind("inertial/mass")}


arm = URDF.load("arm.urdf")
print("in memory:", {link.name: link.inertial.mass for link in arm.links})
arm.save("written.urdf")
before, after = masses("arm.urdf"), masses("written.urdf")
print(f"read {before}, {sum(before.values())} kg; written {after}, {sum(after.values())} kg")
assert before == {"upper_arm": 0.5}
assert after == {"base": 1.0, "upper_arm": 0.5, "tool": 1.0, "camera": 1.0}
PY
