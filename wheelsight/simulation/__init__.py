"""A wheelchair with a depth camera on a building floor: recordings with truth, from MuJoCo (extra `sim`)."""
