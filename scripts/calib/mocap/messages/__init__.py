"""Messages of motion capture: pose_messages is the registry, each other file reads one family."""
