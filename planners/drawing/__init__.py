"""Pictures and pages of plans and episodes, with matplotlib; imported only by the methods that draw."""
