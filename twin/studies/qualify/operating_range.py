"""What this robot asks of a drive, on the motor shaft: the speeds and loads at which drives are judged.

The numbers are those of the Fig. 4 experiment with the assumed robot of `experiments/robots/massage_robot.toml`.
"""

TICK = 1e-3
"""Communication step (s): the one of every experiment here."""
SPEED_IN_USE = 0.5
"""rad/s. Fig. 4 commands 0.50 rad/s at most: where the force loop is triggered and the z reference jumps."""
SPEED_LIMIT = 8.0
"""rad/s. The controller clamps its command there."""
LOAD_IN_USE = 0.1
"""N m. A press of 5 N asks 0.06 N m of each motor, through a belt of N = 2; weight and haste add to it."""
LOAD_PEAK = 0.6
"""N m. Ten presses of 5 N: a drive that holds it has a margin in every task."""
LOAD_MOST = 4.0
"""N m. Where the search for the stall torque ends: no spring of this robot can ask for it."""
SMALL_SPEED = 0.1
"""rad/s. Amplitude for the frequency response: a fifth of the speed in use, four steps of a 0.024 rad/s register."""
BIAS_SPEED = 0.25
"""rad/s. Mean speed of the frequency response: above the amplitude, so that friction never changes sign."""
RESOLUTION = 1.5e-3
"""rad. One count of the robot's own 12-bit motor encoder: an angle that nobody in the robot can see."""
