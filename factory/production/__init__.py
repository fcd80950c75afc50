"""From words to datasets: the command line, its verbs, the scheduler, and exports."""
