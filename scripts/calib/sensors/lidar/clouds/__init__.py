"""Cloud messages: cloud_messages is the registry of types; cloud_layout says what the fields mean;
beams and point times are inferred where a driver does not state them."""
