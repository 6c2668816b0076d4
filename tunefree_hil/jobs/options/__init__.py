"""The options of the commands, each listed once: the fields of a record, with what the command line shows of them."""
