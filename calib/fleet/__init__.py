"""Every arm found in a folder of recordings: identified, validated, diagnosed and compared with its siblings."""
