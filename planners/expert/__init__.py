"""The expert: carries out a plan in the environment, monitors it and replans."""
