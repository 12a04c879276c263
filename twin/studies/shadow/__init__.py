"""The twin beside a robot that runs: it follows the robot's stamps, knows its state, and sees them part.

`filter` has the state, `alarm` the decision, and `fleet` what is normal for robots of which nothing is wrong.
"""

ACCEPT, PROPOSAL = "shadow.accept", "shadow.proposal"
"""Parameters of a live session: true accepts what the other one says."""
ACCEPTED = "shadow.accepted"
"""What was accepted so far, JSON: see `twin.studies.shadow.seen.accepted_values`."""
LINE = "shadow.line"
"""How it goes, as in the terminal."""
