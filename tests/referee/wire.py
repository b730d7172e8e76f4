"""Goals and torque of one servo, as they go over the wire."""

from collections import deque

from referee.travel import Travel

TICK = 360.0 / 4096.0
WINDOW, SLACK = 0.04, 1.5  # [s], [deg]
BRAKING = 600.0  # [deg/s^2], how hard a servo's own profile brakes; goals are sent ahead by it
LEAD = 0.065  # [s], what goals are ahead at speed to make up for delay and back-EMF at P 32
LAG = 0.1  # [s], how far behind its goals a healthy servo is
SEED_SLACK = 1.0  # [deg], play of the gears and a tick
RECOVERY = 0.5  # [s], how long after it was held up a joint is not where it is wanted
HEAVIEST = 3.4  # [N m], to lift 0.3 kg with the arm stretched, friction included
P_GAIN, MIN_LIMIT, MAX_LIMIT, TORQUE, GOAL = 21, 9, 11, 40, 42


def is_held_up(servo):
    """Whether something keeps the joint: a stop or an object it touches, or a protection."""
    shaft = servo.drive.shaft
    return bool(servo.drive.guard.flags) or not shaft.lower < shaft.output < shaft.upper


def _pace(caps):
    """How fast goals may go that are sent ahead of the command [deg/s]."""
    return caps.speed * (1.0 + caps.acceleration / BRAKING) + LEAD * caps.acceleration


class ServoOnWire:
    """What one servo is told; ``report`` takes rule, time and text of a finding."""

    def __init__(self, servo, report):
        self._servo, self._report = servo, report
        self._travel = Travel(WINDOW, SLACK)
        self.goal = None  # [tick], the newest while the servo is driven
        self._seeded = False
        self._was_driven = False
        self._stop = None
        self._held_up = -RECOVERY
        self._holds_itself = False
        self._recent = deque(maxlen=8)  # goals

    # The truth

    def _register(self, address, size=2):
        return int.from_bytes(self._servo.memory.bytes[address : address + size], "little")

    @property
    def _is_driven(self):
        return self._servo.drive.powered and self._servo.drive.torque == 1

    @property
    def _limits(self):
        return self._register(MIN_LIMIT), self._register(MAX_LIMIT)

    def droop(self):
        """How far a joint can stand off its goal under the arm's weight [deg]."""
        full_drive = 4000.0 / max(self._register(P_GAIN, 1), 1) * TICK
        kind = self._servo.drive.motor.kind
        return min(HEAVIEST / (kind.volts * kind.torque_per_volt), 1.0) * full_drive

    def _off(self, goal):
        """From the joint to ``goal`` [deg]."""
        return (goal - self._servo.drive.position) * TICK

    # What happens

    def look(self, t, caps, pushed):
        """Time has passed; the joint may be anywhere now."""
        driven = self._is_driven
        if driven != self._was_driven:
            self._was_driven = driven
            self._recent.clear()
            self._travel.restart()
            if not driven:
                self._seeded, self.goal, self._stop = False, None, None
            elif self.goal is not None:
                self._begin(t, self.goal, caps)
        if pushed or is_held_up(self._servo):
            self._held_up, self._stop = t, None
        if self._servo.drive.guard.flags:  # afterwards it holds where it is until it gets a goal
            self._holds_itself = True
        if self._holds_itself:
            return
        if driven and self.goal is not None and t - self._held_up > RECOVERY:
            self._judge_distance(t, caps)

    def _judge_distance(self, t, caps):
        lead = caps.speed**2 / (2.0 * BRAKING) + LAG * caps.speed
        off, most = abs(self._off(self.goal)), lead + self.droop() + SLACK
        if off > most:
            self._report("distance", t, f"goal {off:.2f} deg from the joint, {most:.2f} allowed")

    def written(self, t, written, caps, jitter):
        """The client writes to this servo."""
        raw = written.value(GOAL, 2)
        if raw is not None:
            self._goal(t, -(raw & 0x7FFF) if raw & 0x8000 else raw, caps, jitter)
        torque = written.value(TORQUE, 1)
        if torque == 1 and not self._is_driven:
            self._judge_seed(t)

    def _goal(self, t, goal, caps, jitter):
        self._holds_itself = False
        lower, upper = self._limits
        if lower != upper and not lower <= goal <= upper:
            self._report("limits", t, f"goal {goal} outside {lower} to {upper}")
        self._seeded = True
        if not self._is_driven:
            self.goal = goal
            if self._servo_takes_it() and not self.is_outside:
                self._judge_near(t, goal)
                self._travel.restart()
            return
        known, self.goal = self.goal is not None, goal
        if self.is_outside:
            self._begin(t, goal, caps)
            return
        if not known:  # somebody else's goals kept it until now
            self._judge_near(t, goal)
            self._begin(t, goal, caps)
            return
        self._judge_travel(t, goal, caps, jitter)
        self._recent.append(goal)
        self._judge_stop(t, goal, caps)

    def _servo_takes_it(self):
        return self._servo.goal_enables_torque

    def _begin(self, t, goal, caps):
        """Goals are compared with this one from now on."""
        self._travel.restart()
        self._travel.excess(t, goal * TICK, _pace(caps))
        self._recent.append(goal)

    def _judge_travel(self, t, goal, caps, jitter):
        speed = _pace(caps)
        excess = self._travel.excess(t, goal * TICK, speed, extra=speed * jitter)
        if excess <= 0.0:
            return
        before, caught = self._recent[-1], self._is_catch(goal)
        self._begin(t, goal, caps)
        if not caught:
            text = f"goal {excess:.2f} deg farther than {speed:.0f} deg/s and {SLACK} deg allow"
            self._report("travel", t, f"{text}: {before} to {goal}, joint at {self._position}")

    @property
    def _position(self):
        return self._servo.drive.position

    def _is_catch(self, goal):
        """Whether the goal went back to where the joint is, which moves nothing."""
        off = abs(self._off(goal))
        came_nearer = any(off < abs(self._off(before)) for before in self._recent)
        return came_nearer and off <= self.droop() + SEED_SLACK

    @property
    def is_outside(self):
        """Whether no goal can keep it where it is: it is brought in at a crawl then."""
        lower, upper = self._limits
        return lower != upper and not lower <= self._position <= upper

    def _judge_seed(self, t):
        if self.is_outside:
            return
        if not self._seeded:
            self._report("seed", t, "torque on without a goal")
        else:
            self._judge_near(t, self.goal)

    def _judge_near(self, t, goal):
        off, most = abs(self._off(goal)), self.droop() + SEED_SLACK
        if off > most:
            self._report(
                "seed", t, f"torque on with the goal {off:.2f} deg away, {most:.2f} allowed"
            )

    # After a Stop

    def stopped(self, t):
        """A Stop was answered: what remains is a ramp."""
        if self.goal is not None:
            self._stop = (t, self.goal)

    def set_off(self):
        self._stop = None

    def _judge_stop(self, t, goal, caps):
        if self._stop is None:
            return
        since, at = self._stop
        ramp = caps.speed**2 / (2.0 * BRAKING) + self.droop() * 0.5 + SLACK
        if abs(goal - at) * TICK > ramp:
            self._stop = None
            text = f"goal went {abs(goal - at) * TICK:.2f} deg after a Stop was answered"
            self._report("stop", t, f"{text} {t - since:.2f} s before; the ramp is {ramp:.2f}")
