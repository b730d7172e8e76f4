#!/bin/sh
# MuJoCo 4.0.0: mj_geomDistance with a height field; then mink 1.3.0, whose CollisionAvoidanceLimit is built on it.
#
# Expected: the distance to the field, as to a box of the same shape, or an error: bodies do collide with height fields.
# Seen: 0.90 to 0.98 m, whether the ball is 350 mm above the field, 50 mm above it or 10 mm in it, while the contacts of
# the same state say -0.010: it is measured to a point near the field's edge. mink takes a height field
# as an obstacle without a word, and the ball is driven 250 mm deep into it; above a box it stops at 10 mm, as it was told.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet mink==1.3.0 mujoco==4.0.0 qpsolvers==4.13.0 daqp==0.11.0
"$folder/venv/bin/python" - <<'PY'
import mink
import mujoco
import numpy as np

XML = """<mujoco>
  <asset><hfield name="ground" nrow="41" ncol="41" size="1 1 0.3 0.1"/></asset>
  <worldbody>
    <geom name="ground" {ground}/>
    <body pos="0 0 0.4"><joint name="lift" type="slide" axis="0 0 1"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
      <body><joint name="along" type="slide" axis="1 0 0"/><geom name="ball" size="0.05" mass="1"/><site name="tip"/></body>
    </body>
  </worldbody>
</mujoco>"""
GROUNDS = {"box": 'type="box" size="1 1 0.1" pos="0 0 -0.1"', "height field": 'type="hfield" hfield="ground"'}
asked, contacts, lowest = {}, {}, {}
for kind, ground in GROUNDS.items():
    model = mujoco.MjModel.from_xml_string(XML.format(ground=ground))
    data = mujoco.MjData(model)
    ground_id, ball_id = model.geom("ground").id, model.geom("ball").id
    for height in (0.35, 0.05, -0.01):
        data.qpos[0] = height + 0.05 - 0.4
        mujoco.mj_forward(model, data)
        asked[kind, height] = mujoco.mj_geomDistance(model, data, ground_id, ball_id, 2.0, None)
        contacts[kind, height] = min((contact.dist for contact in data.contact), default=None)
        print(f"{kind}: ball at {height:+.2f} m: mj_geomDistance {asked[kind, height]:+.3f}, contact {contacts[kind, height]}")
    configuration = mink.Configuration(model)
    configuration.update(np.zeros(2))
    down = mink.FrameTask("tip", "site", position_cost=1.0, orientation_cost=0.0)
    down.set_target(mink.SE3.from_translation(np.array([0.0, 0.0, -0.2])))
    kept_off = mink.CollisionAvoidanceLimit(
        model, [(["ball"], ["ground"])], minimum_distance_from_collisions=0.01, collision_detection_distance=0.3
    )
    limits = [kept_off, mink.VelocityLimit(model, {"lift": 1.0, "along": 1.0})]
    for _ in range(200):
        configuration.integrate_inplace(mink.solve_ik(configuration, [down], 0.01, "daqp", limits=limits), 0.01)
    lowest[kind] = 0.4 + configuration.q[0] - 0.05
    print(f"{kind}: mink brings the ball to {lowest[kind]:+.3f} m")
for height in (0.35, 0.05, -0.01):
    assert abs(asked["box", height] - height) < 1e-6
    assert asked["height field", height] > 0.8
assert abs(contacts["box", -0.01] + 0.01) < 1e-6 and abs(contacts["height field", -0.01] + 0.01) < 1e-3
assert lowest["box"] > 0.0099 and lowest["height field"] < -0.2
PY
