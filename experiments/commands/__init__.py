"""What the commands of the command line do; each module imports what it needs when its command is used."""
