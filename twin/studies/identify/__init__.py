"""Identification of springs, zeros, backlash, friction and the scale from presses on a scale, a correction of Sec.
III.A.
"""
