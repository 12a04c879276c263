"""Replay of a robot's log: position and force from its encoder counts, and the verdict whether robot and twin match."""
