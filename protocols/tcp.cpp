#include "protocols/tcp.h"

#include <fmt/format.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <sys/socket.h>

// The umbrella header of Boost 1.74 does not compile as C++20.
#include <boost/asio/connect.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>

#include "src/core/errors.h"

namespace turntable {
namespace {

using boost::asio::ip::tcp;
using boost::system::error_code;

}  // namespace

Line open_tcp(const std::string& host, std::uint16_t port, Time timeout) {
  const std::string name = fmt::format("{}:{}", host, port);
  boost::asio::io_context context;
  error_code error;
  tcp::resolver resolver(context);
  const auto endpoints = resolver.resolve(host, std::to_string(port), error);
  if (error) throw LineError(fmt::format("{}: unknown host: {}", name, error.message()));

  tcp::socket socket(context);
  error = boost::asio::error::would_block;
  boost::asio::async_connect(
      socket, endpoints,
      [&error](const error_code& result, const tcp::endpoint&) { error = result; });
  context.run_for(timeout);
  if (error == boost::asio::error::would_block) {
    socket.close();
    context.restart();
    context.run();  // lets the handler end while its captures are alive
    throw TimeoutError(fmt::format(
        "{}: no connection within {:g} s. Check address, port and power.", name, seconds(timeout)));
  }
  if (error)
    throw LineError(fmt::format("{}: cannot connect: {}. Check address, port and power.", name,
                                error.message()));
  socket.set_option(tcp::no_delay(true), error);
  socket.set_option(boost::asio::socket_base::keep_alive(true), error);
  return Line(socket.release(), name);
}

namespace {

Line listening_socket(std::uint16_t port, const std::string& address) {
  const std::string name = fmt::format("{}:{}", address, port);
  boost::asio::io_context context;
  try {
    tcp::acceptor acceptor(context, {boost::asio::ip::make_address(address), port});
    return Line(acceptor.release(), name);
  } catch (const boost::system::system_error& error) {
    throw LineError(fmt::format("{}: cannot listen: {}", name, error.code().message()));
  }
}

std::uint16_t bound_port(int fd) {
  sockaddr_storage address{};
  socklen_t size = sizeof address;
  ::getsockname(fd, reinterpret_cast<sockaddr*>(&address), &size);
  return address.ss_family == AF_INET6 ? ntohs(reinterpret_cast<sockaddr_in6&>(address).sin6_port)
                                       : ntohs(reinterpret_cast<sockaddr_in&>(address).sin_port);
}

}  // namespace

TcpListener::TcpListener(std::uint16_t port, const std::string& address)
    : socket_(listening_socket(port, address)), port_(bound_port(socket_.descriptor())) {}

std::optional<Line> TcpListener::accept() {
  const int fd = ::accept4(descriptor(), nullptr, nullptr, SOCK_NONBLOCK | SOCK_CLOEXEC);
  if (fd < 0) return std::nullopt;
  const int on = 1;
  ::setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
  return Line(fd, fmt::format("client of port {}", port_));
}

}  // namespace turntable
