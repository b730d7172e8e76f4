"""The robot description as other programs load it: joints, limits, masses, pose of the tool.

Run by ``run.sh`` in an environment of pinned packages; prints a line a program, exits 1 on a fault.
"""

import os
import sys

import ikpy.chain
import mujoco
import numpy as np
import pinocchio
import urchin
import yourdfpy
from pydrake.all import MultibodyPlant, Parser

FILE = os.path.abspath(sys.argv[1])
JOINTS = ["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper"]
Q = dict(zip(JOINTS, [0.3, -0.4, 0.5, -0.2, 0.6, 0.2], strict=True))
ARM = [Q[name] for name in JOINTS[:5]]


def in_pinocchio():
    model = pinocchio.buildModelFromUrdf(FILE)
    data = model.createData()
    pinocchio.framesForwardKinematics(model, data, np.array(list(Q.values())))
    limits = np.c_[model.lowerPositionLimit, model.upperPositionLimit]
    mass = sum(inertia.mass for inertia in model.inertias)
    T = data.oMf[model.getFrameId("tool")].homogeneous
    return list(model.names)[1:], limits, mass, T


def in_ikpy():
    chain = ikpy.chain.Chain.from_urdf_file(FILE, base_elements=["base_link"])
    joints = chain.links[1:6]
    T = chain.forward_kinematics([0.0, *ARM, *[0.0] * (len(chain.links) - 6)])
    return [link.name for link in joints], [link.bounds for link in joints], None, T


def in_yourdfpy():
    robot = yourdfpy.URDF.load(FILE, load_meshes=False)
    robot.update_cfg(Q)
    joints = robot.actuated_joints
    limits = [(joint.limit.lower, joint.limit.upper) for joint in joints]
    mass = sum(link.inertial.mass for link in robot.robot.links if link.inertial)
    return robot.actuated_joint_names, limits, mass, robot.get_transform("tool", "base_link")


def in_urchin():
    robot = urchin.URDF.load(FILE, lazy_load_meshes=True)
    joints = robot.actuated_joints
    limits = [(joint.limit.lower, joint.limit.upper) for joint in joints]
    T = robot.link_fk(cfg=Q, use_names=True)["tool"]
    return [joint.name for joint in joints], limits, None, T


def in_drake():
    plant = MultibodyPlant(0.001)
    Parser(plant).AddModels(FILE)
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base_link"))
    plant.Finalize()
    context = plant.CreateDefaultContext()
    for name, angle in Q.items():
        plant.GetJointByName(name).set_angle(context, angle)
    joints = [plant.get_joint_actuator(i).joint() for i in plant.GetJointActuatorIndices()]
    limits = [(j.position_lower_limit(), j.position_upper_limit()) for j in joints]
    T = plant.GetFrameByName("tool").CalcPoseInWorld(context).GetAsMatrix4()
    return (
        [joint.name() for joint in joints],
        np.ravel(limits).reshape(-1, 2),
        (plant.CalcTotalMass(context)),
        T,
    )


def in_mujoco():
    compiler = f'<mujoco><compiler fusestatic="false" meshdir="{os.path.dirname(FILE)}"/></mujoco>'
    with open(FILE, encoding="utf-8") as file:
        text = file.read().replace("</robot>", compiler + "</robot>")
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qpos[:] = list(Q.values())
    mujoco.mj_kinematics(model, data)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = data.body("tool").xmat.reshape(3, 3), data.body("tool").xpos
    names = [model.joint(i).name for i in range(model.njnt)]
    return names, model.jnt_range, float(model.body_mass.sum()), T


names, limits, mass, T = in_pinocchio()
faults = 0
for load in (in_pinocchio, in_ikpy, in_yourdfpy, in_urchin, in_drake, in_mujoco):
    try:
        found, theirs, weight, pose = load()
        assert found in (JOINTS, JOINTS[:5]), found
        assert np.allclose(theirs, limits[: len(found)], atol=1e-6), theirs
        assert weight is None or abs(weight - 0.632006) < 1e-6, weight
        assert np.allclose(pose, T, atol=1e-6), pose
        print(
            f"{load.__name__}: order, limits{'' if weight is None else ', mass'}, tool pose equal"
        )
    except Exception as error:
        faults += 1
        print(f"{load.__name__}: WRONG {error!r}")
sys.exit(faults > 0)
