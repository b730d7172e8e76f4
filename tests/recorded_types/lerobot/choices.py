"""Classes registered by name; LeRobot takes this from draccus."""


class Choices:
    _names: dict  # name: class

    @classmethod
    def register_subclass(cls, name):
        def register(subclass):
            cls._names[name] = subclass
            return subclass

        return register

    @classmethod
    def get_choice_name(cls, subclass):
        return next(name for name, each in cls._names.items() if each is subclass)

    @property
    def type(self):
        return self.get_choice_name(type(self))
