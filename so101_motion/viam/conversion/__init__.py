"""Convert Viam's types to ours and back: poses, joints, geometries, kinematics, frames, errors.

Millimetres and degrees end here.
"""
