"""What is published while things go wrong: the table of disasters, its judge, and how it is shown."""
