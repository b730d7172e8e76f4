"""What turns setpoints into movement: bytes, registers and ticks, or a simulated servo.

Nothing here knows why the arm moves; planning is unknown.
"""
