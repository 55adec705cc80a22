"""Where the tip of a moving crane and the hook below it are, from the crane's encoders."""
