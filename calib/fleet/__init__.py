"""From one arm to a plant: every arm found in a folder of recordings, identified, validated, diagnosed and compared with its siblings."""
