"""A browser for each test file, which `make test-browser` runs. Without one, the tests end with what to install."""

import pytest
from support.browser import missing, started


@pytest.fixture(scope="session", autouse=True)
def _programs():
    if told := missing():
        pytest.exit(told, returncode=1)


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    """A webdriver for chromium, with a profile of its own; `support.browser.resize` gives its window another size."""
    driver = started(tmp_path_factory.mktemp("profile"))
    driver.set_script_timeout(60)
    yield driver
    driver.quit()
