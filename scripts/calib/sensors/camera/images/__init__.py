"""Image messages: image_messages is the registry of types; pixel_encodings converts to BGR."""
