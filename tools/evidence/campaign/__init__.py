"""The daemon's process against slaves, lines, disks and clients that misbehave; see tools/campaign.py."""
