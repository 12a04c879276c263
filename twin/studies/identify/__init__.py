"""Section III.A done right: what a press on a scale says about springs, zeros, backlash, friction and the scale.

A log becomes `windows` of slow motion, and what statics asks of them; `identification` finds the parameters that meet
it, how sure they are, and which of them the data cannot tell apart; `identification.identified` is the door.
"""
