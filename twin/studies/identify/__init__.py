"""Identification of springs, zeros, backlash, friction and the scale from presses on a scale, a correction of Sec.
III.A.

`windows` selects slow motion from a log, `balance` has the equations of statics, and `fit` finds the parameters, their
intervals, and the ones that the data cannot separate. `identification.identify_log` does all of that.
"""
