# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

package_name = 'waferbot_plant'

setup(
    name=package_name,
    version='0.1.0',
    packages=find_packages(exclude=['test']),
    package_data={'': ['*.json', '*.yaml', '*.html', '*.xml', 'py.typed', 'config/**/*']},
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/' + package_name]),
        ('share/' + package_name, ['package.xml']),
    ],
    install_requires=['setuptools'],
    zip_safe=False,
    maintainer='waferbot maintainers',
    maintainer_email='maintainers@waferbot.org',
    url='https://github.com/waferbot/waferbot',
    description='The mechanism with its motors, drives and encoders, and the plant node.',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'plant = waferbot_plant.node:main',
        ],
    },
)
