"""What ships read: pure encoders, a motion in, the bytes of one telegram out."""
