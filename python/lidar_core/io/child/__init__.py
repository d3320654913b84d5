"""Files of other people's formats are parsed in a child process, whose end is an error here."""
