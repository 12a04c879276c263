"""The robot drawn from a run's rows, as messages that 3-D viewers understand: `/tf`, `/scene` and `/force`.

The types are Foxglove's (https://docs.foxglove.dev/docs/sdk/schemas), which Lichtblick and Foxglove draw as they are.
What is drawn is the truth: the plant's pose, not the controller's belief; of the force, both.
"""
