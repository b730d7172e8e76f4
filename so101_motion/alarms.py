"""When a joint is in trouble, in words: what the executor ends its motion for.

A status bit alone never is an error: the reading that came with it is good. But a joint whose servo
is hot, overloaded or badly fed must not be pushed on, and whoever moved it must be told why.
"""

from __future__ import annotations

from so101_motion.drivers.health import JointHealth

HOT_C = 65
"""From here on a joint is not moved any more [degC]; the servo itself gives up at 70."""

WARM_C = 55
"""From here on motions get slower [degC]."""

WEAK_V = 5.5
"""Below this a joint is not moved [V]: what a computer's USB port gives has no strength, and makes
servos restart. Chosen; a 7.4 V battery that is empty still has 6."""


def alarms(health: tuple[JointHealth, ...]) -> dict[str, str]:
    """What is wrong with joints and what to do about it, by joint."""
    found: dict[str, str] = {}
    for joint in health:
        if joint.is_silent:
            continue  # the driver says so itself
        if "overheated" in joint.faults or joint.temperature_c >= HOT_C:
            found[joint.joint] = (
                f"its servo is too hot ({joint.temperature_c} degC); let it cool below {WARM_C}"
                " degC and look for what loads it"
            )
        elif "overload" in joint.faults or "overcurrent" in joint.faults:
            found[joint.joint] = (
                f"its servo is overloaded ({100 * abs(joint.load):.0f} % drive, {joint.amps:.2f} A)"
                " and its goal was brought back to where it stands; see what blocks it or take"
                " weight off, then move again"
            )
        elif "voltage" in joint.faults:
            found[joint.joint] = (
                f"its supply of {joint.volts:.1f} V is outside the limits it is set for; check the"
                " power supply and, with 7.4 V servos, that it is not a 12 V one"
            )
        elif joint.volts < WEAK_V:
            found[joint.joint] = (
                f"its supply has only {joint.volts:.1f} V; switch the arm's power supply on (USB"
                " alone is not enough), or check its plugs"
            )
        elif "encoder" in joint.faults:
            found[joint.joint] = "its servo reports a broken encoder; replace the servo"
    return found
