"""Programs, ports and people that tests of several folders need."""
