#!/usr/bin/python3
"""The document schema and the parser agree.

Documents are made from the schema at random, and most of them spoiled at
random; the verdicts of proto/document.schema.json (by a validator of its own)
and of the parser (by the program given) are compared:

- what the parser takes, the schema takes;
- what the schema takes, the parser refuses only for what no schema can say,
  the kinds listed below.

Usage: test_schema.py [COUNT [SEED]], the parser's program in the environment's
DOCUMENT_VERDICTS. Prints its cases as cmocka does.
"""
import copy
import json
import os
import random
import re
import subprocess
import sys

import jsonschema

SCHEMA = json.load(open("proto/document.schema.json"))
DEFS = SCHEMA["$defs"]

# What only the parser can see: sentences of its faults.
BEYOND = [re.compile(words) for words in (
    r"^no node has this id$", r"^another node has this id already$",
    r"^refers to itself through", r"^unknown operator '",
    r"^there is no volume '", r"^must not exceed the least half_size",
    r"^must not both be 0$", r"^must be 0 or at least 1e-09$",
    r"^must be invertible$", r"^must be a unit quaternion",
    r"^must not be parallel to 'axis'$", r"^must exceed 'from' by",
    r"^bends by ", r"^times the radius must be",
    r"^in .* frame its field falls over lengths",
    r"^must be the angle before it or at least", r"^must keep 0 <= alpha0",
)]
# Of a profile's samples: from profile_from_samples.
SAMPLES = re.compile(r"/profile/points(/\d+)?$")


def pick(rng, values):
    return values[rng.randrange(len(values))]


class Maker:
    """Random instances of the schema."""

    def __init__(self, rng):
        self.rng = rng

    def number(self, s):
        least = s.get("minimum", -1e9)
        most = s.get("maximum", 1e9)
        if s.get("type") == "integer":
            return self.rng.randint(least, most)
        choice = self.rng.random()
        if choice < 0.1:
            return least
        if choice < 0.2:
            return most
        if choice < 0.9:
            least, most = max(least, -10), min(most, 10)
        return self.rng.uniform(least, most)

    def string(self, s):
        if self.rng.random() < 0.3:
            return pick(self.rng, ["camel", "organic", "sharp", "mine"])
        return "n%d" % self.rng.randrange(1000)

    def array(self, s, depth):
        least = s.get("minItems", 0)
        most = min(s.get("maxItems", least + 2), least + 3)
        if s is DEFS["rotation"]:
            return pick(self.rng, [[0, 0, 0, 1], [0.6, 0, 0, 0.8]])
        made = []
        for i in range(self.rng.randint(least, most)):
            prefix = s.get("prefixItems", [])
            item = prefix[i] if i < len(prefix) and prefix[i] else s["items"]
            made.append(self.make(item, depth))
        if "contains" in s and not any(made):
            made[self.rng.randrange(len(made))] = 1
        return made

    def thing(self, s, depth):
        required = list(s.get("required", []))
        for rule in s.get("allOf", []):
            if "oneOf" in rule:
                required += pick(self.rng, rule["oneOf"])["required"]
        if "oneOf" in s:
            required += pick(self.rng, s["oneOf"])["required"]
        made = {}
        for name, kind in s.get("properties", {}).items():
            if name in required:
                made[name] = self.make(kind, depth)
            elif self.rng.random() < 0.12 and name != "matrix":
                if not any(name in r for r in self.excluded(s, made)):
                    made[name] = self.make(kind, depth)
        if "alpha" in made:
            made["alpha"].sort()
        for rule in s.get("allOf", []):
            for name, needs in rule.get("dependentRequired", {}).items():
                for need in needs if name in made else []:
                    if need not in made:
                        made[need] = self.make(s["properties"][need], depth)
        return made

    @staticmethod
    def excluded(s, made):
        """Members that exclude one another, by oneOf's of required ones."""
        for rule in [s] + s.get("allOf", []):
            names = [r["required"][0] for r in rule.get("oneOf", [])
                     if "required" in r]
            if any(name in made for name in names) or names:
                yield names

    def make(self, s, depth=0):
        if "$ref" in s:
            name = s["$ref"].rsplit("/", 1)[1]
            if name == "node":
                name = "node_point" if depth > 4 else "node_" + pick(
                    self.rng, DEFS["node"]["properties"]["type"]["enum"])
                depth += 1
            return self.make(DEFS[name], depth)
        if "const" in s:
            return s["const"]
        if "enum" in s:
            return pick(self.rng, s["enum"])
        kind = s.get("type")
        if kind == "object" and "properties" in s:
            return self.thing(s, depth)
        if "oneOf" in s:
            return self.make(pick(self.rng, s["oneOf"]), depth)
        if kind == "object":
            return {"mine": self.make(s["additionalProperties"], depth)}
        if kind == "array":
            return self.array(s, depth)
        if kind == "string":
            return self.string(s)
        if kind == "boolean":
            return self.rng.random() < 0.5
        return self.number(s)

    def document(self):
        made = self.make(SCHEMA)
        return made


def places(value, found):
    """Every container below value."""
    if isinstance(value, (dict, list)):
        found.append(value)
        for item in value.values() if isinstance(value, dict) else value:
            places(item, found)
    return found


JUNK = [None, True, False, 0, -1, 0.5, 1e10, -1e10, 1e-12, 3, "", "camel",
        "x y", [], {}, [0, 0, 0], [1], {"type": "point"}, {"theta": 0.1},
        "smooth", 128.5]


def spoil(rng, document):
    """Changes one place of document."""
    inside = pick(rng, places(document, []))
    keys = list(inside) if isinstance(inside, dict) else list(range(len(inside)))
    if not keys:
        return
    key = pick(rng, keys)
    choice = rng.random()
    if choice < 0.3:
        del inside[key]
    elif choice < 0.75:
        inside[key] = copy.deepcopy(pick(rng, JUNK))
    elif isinstance(inside, list):
        inside.append(copy.deepcopy(pick(rng, JUNK)))
    else:
        names = sorted({n for d in DEFS.values() for n in d.get("properties", {})})
        inside[pick(rng, names + ["unknown"])] = copy.deepcopy(pick(rng, JUNK))


def make_documents(count, seed):
    rng = random.Random(seed)
    documents = []
    for i in range(count):
        document = Maker(rng).document()
        for _ in range(i % 3):
            spoil(rng, document)
        documents.append(document)
    return documents


def ask_parser(program, documents):
    lines = "\n".join(json.dumps(d) for d in documents) + "\n"
    answer = subprocess.run([program], input=lines, capture_output=True,
                            text=True, check=True).stdout.splitlines()
    assert len(answer) == len(documents)
    return [None if line == "ok" else line.split("\t") for line in answer]


def compare(program, count, seed):
    """What is wrong, and how many both took, both refused, and only a parser
    could refuse."""
    validator = jsonschema.Draft202012Validator(SCHEMA)
    documents = make_documents(count, seed)
    wrong, took, refused, beyond = [], 0, 0, 0
    for document, faults in zip(documents, ask_parser(program, documents)):
        valid = validator.is_valid(document)
        text = json.dumps(document)
        if faults is None and not valid:
            error = jsonschema.exceptions.best_match(
                validator.iter_errors(document))
            wrong.append("only the parser takes %s: %s" % (text, error.message))
        elif faults is None:
            took += 1
        elif not valid:
            refused += 1
        elif all(SAMPLES.search(pointer) or
                 any(r.search(detail) for r in BEYOND)
                 for pointer, detail in zip(faults[::2], faults[1::2])):
            beyond += 1
        else:
            wrong.append("only the schema takes %s: %s" % (text, faults))
    return wrong, took, refused, beyond


def main():
    program = os.environ["DOCUMENT_VERDICTS"]
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 3000
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 1
    name = "test_schema_and_parser_agree_on_random_documents"
    print("[ RUN      ] " + name)
    wrong, took, refused, beyond = compare(program, count, seed)
    print("measured: of %d documents both take %d, both refuse %d, and %d fail "
          "only beyond what a schema says" % (count, took, refused, beyond))
    # All kinds must occur, or nothing is tested.
    fine = not wrong and min(took, refused, beyond) > count // 50
    for sentence in wrong[:5]:
        print(sentence[:3000])
    print(("[       OK ] " if fine else "[  FAILED  ] ") + name)
    sys.exit(0 if fine else 1)


if __name__ == "__main__":
    main()
