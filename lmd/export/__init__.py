"""Files of a finished deployment: tag maps for other programs, the mounting plan, the print sheets."""
