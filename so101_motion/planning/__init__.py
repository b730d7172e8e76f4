"""From a request to a trajectory: numbers in, numbers out.

No time passes here, no thread runs, nothing is read or written, and Viam is unknown. Pinocchio,
coal, toppra and ruckig each have one door; what comes out is ours, typed and in SI.
"""
