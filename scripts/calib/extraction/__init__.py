"""Stage extract: keypoints of one sensor, from the initial guess to the working pose that all its
views agree on. extractor_registry has one extractor per kind of sensor."""
