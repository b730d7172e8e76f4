"""Viam's types to ours and back: poses, joint positions, geometries, kinematics, frames, errors.

Millimetres and degrees end here.
"""
