// A program of Fast DDS: takes /odom, /map and /tf, drives by /cmd_vel until the robot is at x = 2.5 m, and ends.
// peer DOMAIN; it prints "map WIDTH HEIGHT OCCUPIED", "tf PARENT CHILD …" and "odom X FRAME CHILD".

#include <atomic>
#include <chrono>
#include <cstdlib>
#include <iostream>
#include <string>
#include <thread>

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
#include <fastrtps/utils/IPLocator.h>

#include "rosPubSubTypes.h"

using namespace eprosima::fastdds::dds;
using eprosima::fastrtps::rtps::IPLocator;
using eprosima::fastrtps::rtps::Locator_t;

template <class Type>
Topic* topic_of(DomainParticipant* participant, const std::string& name) {
  TypeSupport type(new Type());
  type.register_type(participant);
  return participant->create_topic(name, type.get_type_name(), TOPIC_QOS_DEFAULT);
}

DataReader* reader_of(Subscriber* subscriber, Topic* topic, bool is_kept) {
  DataReaderQos qos = DATAREADER_QOS_DEFAULT;
  qos.reliability().kind = RELIABLE_RELIABILITY_QOS;
  if (is_kept) qos.durability().kind = TRANSIENT_LOCAL_DURABILITY_QOS;
  return subscriber->create_datareader(topic, qos);
}

int main(int argc, char** argv) {
  const int domain = argc > 1 ? std::atoi(argv[1]) : 0;
  // Loopback has no multicast: participants are looked for at the ports of the first few.
  DomainParticipantQos qos = PARTICIPANT_QOS_DEFAULT;
  auto transport = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
  transport->interfaceWhiteList.push_back("127.0.0.1");
  qos.transport().use_builtin_transports = false;
  qos.transport().user_transports.push_back(transport);
  for (int place = 0; place < 8; ++place) {
    Locator_t locator;
    locator.kind = LOCATOR_KIND_UDPv4;
    IPLocator::setIPv4(locator, "127.0.0.1");
    IPLocator::setPhysicalPort(locator, static_cast<uint16_t>(7400 + 250 * domain + 10 + 2 * place));
    qos.wire_protocol().builtin.initialPeersList.push_back(locator);
  }
  auto* participant = DomainParticipantFactory::get_instance()->create_participant(domain, qos);
  if (participant == nullptr) return 2;
  auto* subscriber = participant->create_subscriber(SUBSCRIBER_QOS_DEFAULT);
  auto* publisher = participant->create_publisher(PUBLISHER_QOS_DEFAULT);
  auto* odom = reader_of(subscriber, topic_of<nav_msgs::msg::dds_::Odometry_PubSubType>(participant, "rt/odom"), false);
  auto* map = reader_of(subscriber, topic_of<nav_msgs::msg::dds_::OccupancyGrid_PubSubType>(participant, "rt/map"), true);
  auto* tf = reader_of(subscriber, topic_of<tf2_msgs::msg::dds_::TFMessage_PubSubType>(participant, "rt/tf"), false);
  auto* velocity_topic = topic_of<geometry_msgs::msg::dds_::Twist_PubSubType>(participant, "rt/cmd_vel");
  auto* velocity = publisher->create_datawriter(velocity_topic, DATAWRITER_QOS_DEFAULT);
  nav_msgs::msg::dds_::Odometry_ where;
  nav_msgs::msg::dds_::OccupancyGrid_ grid;
  tf2_msgs::msg::dds_::TFMessage_ frames;
  SampleInfo info;
  bool has_map = false, has_frames = false, has_odom = false;
  const auto ends = std::chrono::steady_clock::now() + std::chrono::seconds(40);
  while (std::chrono::steady_clock::now() < ends) {
    while (map->take_next_sample(&grid, &info) == ReturnCode_t::RETCODE_OK) {
      if (!info.valid_data || has_map) continue;
      int occupied = 0;
      for (auto cell : grid.data()) occupied += cell == 100;
      std::cout << "map " << grid.info().width() << " " << grid.info().height() << " " << occupied << std::endl;
      has_map = true;
    }
    while (tf->take_next_sample(&frames, &info) == ReturnCode_t::RETCODE_OK) {
      if (!info.valid_data || has_frames || frames.transforms().size() < 2) continue;
      std::cout << "tf";
      for (auto& one : frames.transforms()) std::cout << " " << one.header().frame_id() << " " << one.child_frame_id();
      std::cout << std::endl;
      has_frames = true;
    }
    while (odom->take_next_sample(&where, &info) == ReturnCode_t::RETCODE_OK) has_odom = has_odom || info.valid_data;
    const double x = where.pose().pose().position().x();
    if (has_map && has_frames && has_odom && x > 2.5) {
      std::cout << "odom " << x << " " << where.header().frame_id() << " " << where.child_frame_id() << " "
                << where.twist().twist().linear().x() << std::endl;
      return 0;
    }
    if (has_map && has_frames && has_odom) {
      geometry_msgs::msg::dds_::Twist_ twist;
      twist.linear().x(0.3);
      velocity->write(&twist);
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(40));
  }
  std::cerr << "not all came: map " << has_map << " tf " << has_frames << " odom " << has_odom << std::endl;
  return 1;
}
