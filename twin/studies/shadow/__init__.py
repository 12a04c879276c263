"""Digital twin of a running robot: it follows the robot's messages, estimates its state, and detects divergence."""

ACCEPT_PARAMETER, PROPOSAL_PARAMETER = "shadow.accept", "shadow.proposal"
"""Parameters of a live session: the proposed change, and a button that accepts it when set to true."""
ACCEPTED_PARAMETER = "shadow.accepted"
"""Parameter with the changes accepted so far, JSON; see `twin.studies.shadow.live_view.accepted_values`."""
LINE_PARAMETER = "shadow.line"
