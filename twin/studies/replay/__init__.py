"""Replay of a robot's log: position and force from its encoder counts, and a verdict: do robot and twin match?"""
