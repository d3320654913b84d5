"""Commands about finished runs: scores, events, reports, viewers."""
