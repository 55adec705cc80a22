"""Evidence: the accuracy tables, each figure beside the least error that is possible on the same record."""
