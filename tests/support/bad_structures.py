"""Files of studies of structures, and what the message about each mistake must contain."""

HEAD = '[system]\nmodel = "LinearStructure"\nmass = [1.0, 0.5]\nstiffness = [2, 1]\ncontact = 0\n'
CONTACT = "[[system.contacts]]\nmass = 0\nnormal_force = 5.0\nmu = 0.2\n"
ROW_KEYS = "mass = 2\nbetween = 3.0\nto_ground = 0.5\n"
STOREYS = '[system]\nmodel = "storeys_on_bearing"\nmass = [3.0, 2.0, 1.0]\nstiffness = [50, 40.0]\nmu = 0.1\n'


def changed(old: str, new: str) -> str:
    """The file of a structure with one contact, in which something else stands."""
    return (HEAD + CONTACT).replace(old, new)


BAD_STRUCTURES = {
    "no contacts": (HEAD, ["[system] lacks [system.contacts]", "which LinearStructure needs"]),
    "contacts in no list": (HEAD + "[system.contacts]\nmass = 0", ["contacts must be sections [[system.contacts]]"]),
    "empty list": (HEAD + "contacts = []", ["contacts must be sections [[system.contacts]]", "[] was given"]),
    "number for a contact": (
        HEAD + "contacts = [1]",
        ["contacts[0] must be a section [system.contacts[0]] of keys, but 1 was given"],
    ),
    "misspelt key of a contact": (
        changed("normal_force", "normal_fore"),
        ["unknown key normal_fore in [system.contacts[0]]; did you mean normal_force?"],
    ),
    "key of the system in a contact": (
        HEAD + CONTACT + "t1 = 3.0",
        ["unknown key t1 in [system.contacts[0]]; t1 belongs in [run]"],
    ),
    "contact outside": ("[[contacts]]\nmass = 0", ["contacts belongs in [system] of the model LinearStructure"]),
    "nothing rubs": (
        changed("mass = 0\n", ""),
        ["in [system.contacts[0]], mass, between or direction", "none was given"],
    ),
    "two places": (
        changed("mass = 0\n", "mass = 0\nbetween = [0, 1]\n"),
        ["in [system.contacts[0]]", "mass and between were given"],
    ),
    "no such mass": (
        HEAD + CONTACT + CONTACT.replace("mass = 0", "mass = 2"),
        ["in [system], of contacts[1], mass must name a mass from 0 to 1, but 2 was given"],
    ),
    "no such neighbour": (changed("mass = 0\n", "between = [0, -1]\n"), ["between must name a mass from 0 to 1", "-1"]),
    "one neighbour": (
        changed("mass = 0\n", "between = [0]\n"),
        ["in [system.contacts[0]], between must hold the numbers of two masses, but [0] was given"],
    ),
    "direction of another length": (
        changed("mass = 0\n", "direction = [1.0]\n"),
        ["in [system], direction of contact 0 must hold 2 numbers"],
    ),
    "the same contact twice": (HEAD + CONTACT + CONTACT, ["in [system], contacts must be independent of each other"]),
    "no normal force": (
        changed("normal_force = 5.0\n", ""),
        ["[system.contacts[0]] lacks normal_force (N, or a section", "which Contact needs"],
    ),
    "negative normal force": (
        changed("5.0", "-5.0"),
        ["normal_force in [system.contacts[0]] must be greater than 0 or a section", "but -5.0 was given"],
    ),
    "text for a normal force": (
        changed("5.0", '"5"'),
        ["normal_force in [system.contacts[0]] must be a number or a section of the law Harmonic", '"5"'],
    ),
    "normal force of no law": (
        changed("5.0", "{ amplitude = 1.0 }"),
        ["[system.contacts[0].normal_force] lacks law, which must be Harmonic, SumOfHarmonics, Recorded or ForceSteps"],
    ),
    "normal force of an unknown law": (
        changed("5.0", '{ law = "ForceStep" }'),
        ["law in [system.contacts[0].normal_force] must be one of", "did you mean ForceSteps?"],
    ),
    "normal force that lacks a key": (
        changed("5.0", '{ law = "ForceSteps", times = [0, 1] }'),
        ["[system.contacts[0].normal_force] lacks values", "which ForceSteps needs"],
    ),
    "no friction": (changed("mu = 0.2\n", ""), ["in [system.contacts[0]], mu or [system.contacts.friction] must give"]),
    "friction twice": (
        changed("mu = 0.2\n", "mu = 0.2\nfriction = { mu = 0.3 }\n"),
        ["mu and [system.contacts.friction] both give the friction"],
    ),
    "static below kinetic": (
        changed("mu = 0.2\n", "friction = { mu = 0.3, mu_static = 0.2 }\n"),
        ["in [system.contacts[0].friction], mu_static must be at least mu = 0.3"],
    ),
    "negative mu": (changed("0.2", "-0.2"), ["mu in [system.contacts[0]] must be greater than or equal to 0"]),
    "mass that is none": (
        changed("[1.0, 0.5]", "1.0"),
        ["in [system], mass must be a list of numbers, the diagonal", "1.0"],
    ),
    "text in a matrix": (changed("[2, 1]", '[2, "1"]'), ["in [system], stiffness must be a list of numbers"]),
    "infinite mass": (changed("[1.0, 0.5]", "[1.0, inf]"), ["in [system], mass must be a list of numbers"]),
    "uneven rows": (changed("[2, 1]", "[[2, 1], [1]]"), ["stiffness must be a list of numbers", "rows"]),
    "asymmetric": (changed("[2, 1]", "[[2, 1], [0, 1]]"), ["in [system], stiffness must be symmetric"]),
    "singular mass": (changed("[1.0, 0.5]", "[1.0, 0.0]"), ["in [system], mass must be positive definite"]),
    "other sizes": (changed("[2, 1]", "[2, 1, 1]"), ["in [system], stiffness must be a symmetric matrix (2, 2)"]),
    "no such counted contact": (
        changed("contact = 0", "contact = 1"),
        ['in [system], contact must name contact 0, the only one, or be "all", but 1 was given'],
    ),
    "counted by a word": (
        changed("contact = 0", 'contact = "both"'),
        ["contact must be the number of a contact", '"both"'],
    ),
    "not said what is counted": (changed("contact = 0\n", ""), ["[system] lacks contact (whose sticks are counted"]),
    "forces that do not fit": (
        changed("contact = 0", "contact = 0\nforce = [1.0]"),
        ["force must be a tuple of 2 forces"],
    ),
    "text for a force": (
        changed("contact = 0", 'contact = 0\nforce = [1.0, "2"]'),
        ["force[1] in [system] must be a number or a section of the law Harmonic", '"2"'],
    ),
    "short initial state": (
        HEAD + CONTACT + "[run]\ninitial_state = [0.0, 1.0]",
        ["initial_state in [run] must hold 4 numbers, the positions and then the velocities", "but 2 were given"],
    ),
    "text in an initial state": (
        HEAD + CONTACT + '[run]\ninitial_state = [0, "1", 0, 0]',
        ['initial_state[1] in [run] must be a number or { low = ..., high = ... }, but "1" was given'],
    ),
    "range that falls": (
        HEAD + CONTACT + "[run]\ninitial_state = [0, { low = 1, high = 0 }, 0, 0]",
        ["in [run.initial_state[1]], high must be above low"],
    ),
    "start of a mass on a spring": (
        HEAD + CONTACT + "[run]\ninitial_position = 0.0",
        ["initial_position in [run] of the model LinearStructure", "belongs in [run] of the model MassSpring"],
    ),
    "state of a mass on a spring": (
        "[run]\ninitial_state = [0.0, 1.0]",
        ["initial_state in [run] of the model MassSpring", "block_row, storeys_on_bearing or friction_pendulum"],
    ),
    "voltage": (
        HEAD + CONTACT + '[base]\nlaw = "SourceVoltage"',
        ["model in [system] is LinearStructure", "MotorCart"],
    ),
    "misspelt model": ('[system]\nmodel = "blockrow"', ["model in [system]", "did you mean block_row?"]),
    "no blocks": (
        f'[system]\nmodel = "block_row"\nblocks = 0\n{ROW_KEYS}normal_force = 1\nmu = 0.3\ncontact = 0\n',
        ["blocks in [system] must be greater than or equal to 1"],
    ),
    "row that counts no block": (
        f'[system]\nmodel = "block_row"\nblocks = 3\n{ROW_KEYS}normal_force = 1\nmu = 0.3\ncontact = 3\n',
        ["in [system], contact must name a contact from 0 to 2"],
    ),
    "storeys that do not fit": (
        STOREYS.replace("[50, 40.0]", "[50]"),
        ["in [system], stiffness must hold 2 finite numbers"],
    ),
    "storey of a negative mass": (
        STOREYS.replace("[3.0, ", "[-3.0, "),
        ["in [system], mass must hold two positive numbers"],
    ),
}
