# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

package_name = 'waferbot_pmac'

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
    description='The Turbo PMAC servo, its trajectories and I-variables, and the PMAC node.',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'pmac = waferbot_pmac.node:main',
        ],
    },
)
