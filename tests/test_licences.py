"""The page of licences says what the dependencies' own metadata says."""

import importlib.util
from pathlib import Path

import pytest

FILE = Path(__file__).parents[1] / "docs/licences.py"


@pytest.fixture(scope="module")
def licences():
    spec = importlib.util.spec_from_file_location("licences", FILE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_dependency_is_on_the_page_with_who_asks_for_it(licences):
    asked = {package: ", ".join(by) for package, by in licences.asked_for().items()}
    assert asked == {package: by for package, (by, _) in licences.known().items()}


def test_each_licence_is_the_one_of_the_metadata(licences):
    listed = {package: licence for package, (_, licence) in licences.known().items()}
    installed = {package: licences.licence(package) for package in listed}
    # Words change from version to version ("MIT License", "MIT"): their first one is what must stand.
    for package, licence in installed.items():
        if licence is not None:
            assert licence.split()[0].rstrip(",").upper()[:3] == listed[package].split()[0].upper()[:3], (
                package
            )


def test_all_are_permissive(licences):
    permissive = ("MIT", "BSD", "APACHE", "PSF", "PYTHON SOFTWARE", "HPND", "ZLIB", "0BSD", "EPL")
    for package, (_, licence) in licences.known().items():
        assert any(word in licence.upper() for word in permissive), f"{package}: {licence}"
