# SPDX-License-Identifier: Apache-2.0
from glob import glob

from setuptools import find_packages, setup

package_name = 'waferbot_twin'

setup(
    name=package_name,
    version='0.1.0',
    packages=find_packages(exclude=['test']),
    package_data={
        '': ['*.json', '*.yaml', '*.html', '*.xml', '*.py.txt', 'py.typed', 'config/**/*'],
        'waferbot_twin.view': ['page/*.*', 'page/vendor/*.*'],
    },
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/' + package_name]),
        ('share/' + package_name, ['package.xml']),
        ('share/' + package_name + '/launch', glob('launch/*.*')),
    ],
    install_requires=['setuptools'],
    zip_safe=False,
    maintainer='waferbot maintainers',
    maintainer_email='maintainers@waferbot.org',
    url='https://github.com/waferbot/waferbot',
    description='The twin as a whole: run, record, replay, plot; the waferbot command and the launch files.',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'composed = waferbot_twin.composed:main',
            'joint_bridge = waferbot_twin.ros2_control.bridge:main',
            'recorder = waferbot_twin.record:main',
            'waferbot = waferbot_twin.cli:main',
        ],
    },
)
