"""The twin beside a robot that runs: it follows the robot's stamps, knows its state, and sees them part.

`filter` has the state, `alarm` the decision, and `fleet` what is normal for robots of which nothing is wrong.
"""

ACCEPT_PARAMETER, PROPOSAL_PARAMETER = "shadow.accept", "shadow.proposal"
"""Parameters of a live session: true accepts what the other one says."""
ACCEPTED_PARAMETER = "shadow.accepted"
"""What was accepted so far, JSON: see `twin.studies.shadow.live_view.accepted_values`."""
LINE_PARAMETER = "shadow.line"
"""How it goes, as in the terminal."""
