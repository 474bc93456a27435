"""Files of a finished deployment: tag maps for other programs, the mounting plan, and the print sheets."""
