"""Motion capture messages. pose_messages is the registry of types; each file reads one family."""
