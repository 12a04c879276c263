// The joints of a robot by Fast DDS of Debian, C++, as rmw_fastrtps publishes: publisher ANGLES RATE SECONDS [AHEAD].
// ANGLES: rows of six doubles, rad; its clock is AHEAD of this machine's (s). The type's code beside this file was generated: fastddsgen JointState.idl
#include "JointStatePubSubTypes.h"

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/topic/Topic.hpp>
#include <fstream>
#include <thread>

using namespace eprosima::fastdds::dds;
using Clock = std::chrono::steady_clock;

int main(int argc, char **argv) {
  if (argc < 4) return 2;
  const long period = long(1e9 / std::atof(argv[2])), n = long(std::atof(argv[2]) * std::atof(argv[3]));
  std::vector<std::array<double, 6>> angles;
  std::ifstream file(argv[1], std::ios::binary);
  for (std::array<double, 6> row; file.read(reinterpret_cast<char *>(row.data()), sizeof row);) angles.push_back(row);
  if (angles.empty()) return 2;

  const char *domain = std::getenv("ROS_DOMAIN_ID");
  auto *robot = DomainParticipantFactory::get_instance()->create_participant(domain ? std::atoi(domain) : 0,
                                                                             PARTICIPANT_QOS_DEFAULT);
  auto *support = new sensor_msgs::msg::dds_::JointState_PubSubType();
  support->auto_fill_type_object(false);
  support->auto_fill_type_information(false);
  TypeSupport type(support);
  type.register_type(robot);
  auto *topic = robot->create_topic("rt/joint_states", type.get_type_name(), TOPIC_QOS_DEFAULT);
  DataWriterQos qos = DATAWRITER_QOS_DEFAULT;
  qos.reliability().kind = RELIABLE_RELIABILITY_QOS;
  qos.durability().kind = VOLATILE_DURABILITY_QOS;
  qos.history().depth = 10;
  qos.endpoint().history_memory_policy = eprosima::fastrtps::rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
  auto *writer = robot->create_publisher(PUBLISHER_QOS_DEFAULT)->create_datawriter(topic, qos);
  for (PublicationMatchedStatus status; writer->get_publication_matched_status(status), !status.current_count;)
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  std::this_thread::sleep_for(std::chrono::milliseconds(300));

  sensor_msgs::msg::dds_::JointState_ message;
  message.header().frame_id("base");
  message.name({"m1", "m2", "m3", "l1", "l2", "l3"});
  const auto begun = Clock::now();
  const long long since = std::chrono::nanoseconds(std::chrono::system_clock::now().time_since_epoch()).count() +
                          (argc > 4 ? (long long)(std::atof(argv[4]) * 1e9) : 0);
  for (long k = 0; k < n; ++k) {
    std::this_thread::sleep_until(begun + std::chrono::nanoseconds(k * period));
    const long long stamp = since + k * period;
    message.header().stamp().sec(int(stamp / 1000000000LL));
    message.header().stamp().nanosec(unsigned(stamp % 1000000000LL));
    const auto &row = angles[std::size_t(k) % angles.size()];
    message.position(std::vector<double>(row.begin(), row.end()));
    writer->write(&message);
  }
  std::this_thread::sleep_for(std::chrono::milliseconds(1000));
  std::printf("%ld\n", n);
}
