"""Where keyframes are by all that is known of them: the pose graph, and which loops it takes in."""
