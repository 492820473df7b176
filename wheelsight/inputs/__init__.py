"""Files from strangers: what is opened, and how text, YAML, JSON and headers of images are taken."""

from wheelsight.inputs.arrays import ArrayFile, ArrayHeader
from wheelsight.inputs.decompressed import decompress_into, decompressed
from wheelsight.inputs.gate import Kind, is_there, lines_of, open_binary, read_bytes, read_text
from wheelsight.inputs.json_text import parse_json
from wheelsight.inputs.pictures import picture_size, picture_within, scan_count
from wheelsight.inputs.plain_rows import plain_rows
from wheelsight.inputs.words import as_number, numbers_with_commas, split_words, unquoted
from wheelsight.inputs.yaml_files import YAML_FILE, line_of, parse_yaml, read_yaml

__all__ = [
    "YAML_FILE",
    "ArrayFile",
    "ArrayHeader",
    "Kind",
    "as_number",
    "decompress_into",
    "decompressed",
    "is_there",
    "line_of",
    "lines_of",
    "numbers_with_commas",
    "open_binary",
    "parse_json",
    "parse_yaml",
    "picture_size",
    "picture_within",
    "plain_rows",
    "read_bytes",
    "read_text",
    "read_yaml",
    "scan_count",
    "split_words",
    "unquoted",
]
